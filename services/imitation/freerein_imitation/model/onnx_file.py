"""Writes a step of a policy as an ONNX graph, and checks that ONNX runtime computes what the policy does."""

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import FailedPrecondition, Unimplemented, quoted
from freerein_imitation.model.onnx_graph import PolicyGraph, Port

TOLERANCE = 1e-3
"""Greatest difference between an output of the graph and of the policy: processors round a quotient of small numbers
by 1e-4 apart."""

_RANK_TOLERANCE = 0.05
"""The same for `in_distribution`, a rank among held-out answers, which rounding moves by a step or two."""

_CHECKED_ROBOTS, _CHECKED_STEPS = 5, 3
_INT64 = 7  # as ONNX numbers types
_HINT = "The card and the weights are in the model's folder, `models/imitation` of the data directory."

Arrays = dict[str, npt.NDArray[Any]]


def write_graph(graph: PolicyGraph, path: Path) -> None:
    """Writes a graph as an ONNX file.

    Raises:
        FailedPrecondition: ONNX is not installed.
        Unimplemented: The policy does what cannot be a graph, or ONNX runtime computes something else.
    """
    try:
        import onnxruntime
        import onnxscript
    except ImportError as error:
        raise FailedPrecondition(
            f"An export needs onnx, onnxscript and onnxruntime; {error.name} is not installed.",
            hint="pip install -c constraints.txt -e 'services/imitation[onnx]'",
        ) from error
    inputs, outputs = ([each.name for each in ports] for ports in (graph.inputs, graph.outputs))
    example = _tensors(_first_step(graph, np.random.default_rng(0), robots=2))
    any_batch = tuple({0: torch.export.Dim.DYNAMIC} for _ in example)
    try:
        with _without_warnings(), torch.no_grad():
            traced = torch.export.export(graph.eval(), example, dynamic_shapes=(any_batch,), strict=False)
            torch.onnx.export(
                traced,
                f=path,
                external_data=False,
                input_names=inputs,
                output_names=outputs,
                verbose=False,
                custom_translation_table=_translations(onnxscript.opset18),
            )
        session = onnxruntime.InferenceSession(path)
    except OSError:
        raise  # of a full disk
    except Exception as error:  # torch and ONNX runtime raise many
        raise Unimplemented(
            f"A policy to export must be a graph of operations that ONNX has; got: {quoted(str(error))}.", hint=_HINT
        ) from error
    _check(graph, lambda given: session.run(outputs, given))


def _translations(op: Any) -> dict[Any, Callable[..., Any]]:
    """Returns the operations of torch that its exporter lacks, as operations of an ONNX opset."""

    def median(values: Any, dim: int, _keepdim: bool = False) -> Any:
        count = op.Div(op.Add(op.Shape(values, start=dim, end=dim + 1), 1), 2)
        return tuple(op.Gather(each, -1, axis=dim) for each in op.TopK(values, count, axis=dim, largest=0))

    def searchsorted(boundaries: Any, values: Any, **_: Any) -> Any:  # with right=True, of one row
        is_below = op.LessOrEqual(op.Unsqueeze(boundaries, [0]), op.Unsqueeze(values, [1]))
        return op.ReduceSum(op.Cast(is_below, to=_INT64), [1], keepdims=0)

    def cdist(first: Any, second: Any, *_: Any) -> Any:  # Euclidean, of matrices
        return op.ReduceL2(op.Sub(op.Unsqueeze(first, [1]), op.Unsqueeze(second, [0])), [2], keepdims=0)

    aten = torch.ops.aten
    return {aten.median.dim: median, aten.searchsorted.Tensor: searchsorted, aten._cdist_forward.default: cdist}


def _check(graph: PolicyGraph, run: Callable[[Arrays], list[npt.NDArray[Any]]]) -> None:
    """Raises Unimplemented where a graph's outputs for random frames are not the policy's.

    States and executed actions are those of the step before.
    """
    rng, carried = np.random.default_rng(1), dict[str, npt.NDArray[Any]]()
    for _ in range(_CHECKED_STEPS):
        given = {**_first_step(graph, rng, robots=_CHECKED_ROBOTS), **carried}
        with torch.inference_mode():
            expected = [each.numpy() for each in graph(*_tensors(given))]
        for port, found, value in zip(graph.outputs, run(given), expected, strict=True):
            atol = _RANK_TOLERANCE if port.name == "in_distribution" else TOLERANCE
            if found.shape != value.shape or not np.allclose(found, value, rtol=0, atol=atol):
                raise Unimplemented(
                    f"ONNX runtime must compute what the policy does, within {atol:g}; `{port.name}` differs.",
                    hint=_HINT,
                )
        outputs = dict(zip((each.name for each in graph.outputs), expected, strict=True))
        carried = {"executed_actions": outputs["actions"][:, 0]}
        if "next_state" in outputs:
            carried["state"] = outputs["next_state"]


def _first_step(graph: PolicyGraph, rng: np.random.Generator, *, robots: int) -> Arrays:
    """Returns inputs of some robots without a state: frames of noise."""
    return {each.name: _value(each, rng, robots=robots, goals=len(graph.goals)) for each in graph.inputs}


def _value(port: Port, rng: np.random.Generator, *, robots: int, goals: int) -> npt.NDArray[Any]:
    shape = (robots, *port.shape)
    if port.dtype == "uint8":
        return rng.integers(256, size=shape, dtype=np.uint8)
    if port.name == "goal":
        return rng.integers(goals, size=shape)
    if port.name == "draws":
        return rng.random(shape)
    return np.full(shape, port.start, port.dtype)


def _tensors(given: Arrays) -> tuple[torch.Tensor, ...]:
    return tuple(map(torch.from_numpy, given.values()))


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Leaves out what torch's exporter says of itself and of packages that are not installed."""
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
