"""Exports policies as folders that need nothing of freerein.

<folder>/card.json           the model's card; `onnx` says what the graph takes and returns, and what is left out
         model.safetensors   weights, and whatever else the model's folder has
         policy.onnx         one control step, from frames to actions
         README.txt          how to run it
"""

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.atomic_files import new_folder, write_atomic
from freerein.errors import InvalidInput, Unimplemented
from freerein.learning.model_files import MODEL, read_card
from freerein.model_store import MANIFEST
from freerein_imitation.core.inputs import parse_text
from freerein_imitation.core.publish import convert
from freerein_imitation.methods import METHODS
from freerein_imitation.model.onnx_file import TOLERANCE, write_graph
from freerein_imitation.model.onnx_graph import PolicyGraph
from freerein_imitation.model.policy import Policy, PolicySpec
from freerein_imitation.model.torch_policy import TorchPolicy

GRAPH, README = "policy.onnx", "README.txt"

_README = """\
A policy that freerein learned. card.json says what it is and how it was trained; its `onnx` says what policy.onnx
takes and returns, a batch first, and what is left out. To run it, after `pip install onnxruntime`:

import json, pathlib, numpy, onnxruntime
policy = onnxruntime.InferenceSession("policy.onnx")
card = json.loads(pathlib.Path("card.json").read_text())["onnx"]
given = {{i["name"]: numpy.full([1, *i["shape"]], i["start"], i["dtype"]) for i in card["inputs"]}}
while True:
    given["{frame}"][0] = ...  # the newest frame, uint8 {size}; other inputs of the card alike
    got = dict(zip([o["name"] for o in card["outputs"]], policy.run(None, given)))
    action = got["actions"][0, 0]  # execute it, every {control_dt_s:g} s
    given["executed_actions"][0] = action  # or what the robot did in its place
    given.update({{"state": got["next_state"]}} if "next_state" in got else {{}})
"""


def export_policy(source: Path, folder: Path, *, data: str, goal_texts: Sequence[str] = ()) -> None:
    """Exports a policy.

    Args:
        source: Folder of a model of this service, of a stored policy of ppo, or artifacts of a ppo run.
        folder: Written; new or empty.
        data: Entry `data` of the card of a policy of ppo.
        goal_texts: Texts that may be goals beside those that the policy was trained for.

    Raises:
        AlreadyExists: The folder to write is not empty.
        NotFound: There is no such run.
        InvalidInput: The policy's files are malformed, or it cannot follow a text.
        FailedPrecondition: The run has no policy, or ONNX is not installed.
        Unimplemented: The policy cannot be a graph.
    """
    with new_folder(folder) as written, tempfile.TemporaryDirectory() as temporary:
        model = source
        if not (source / MODEL.card).is_file():
            model = Path(temporary) / "model"
            convert(source, model, data=data)
        _write(model, written, goal_texts)


def _write(model: Path, folder: Path, goal_texts: Sequence[str]) -> None:
    """Writes what is exported of the policy in a model's folder."""
    policy = METHODS.load(model, "cpu")
    graph = PolicyGraph(_as_torch(policy), _goals(policy.spec, goal_texts))
    write_graph(graph, folder / GRAPH)
    for path in model.iterdir():
        if path.name not in (MANIFEST, MODEL.card):
            shutil.copyfile(path, folder / path.name)
    card = {**read_card(model), "onnx": _entry(graph, policy.spec)}
    write_atomic(folder / MODEL.card, json.dumps(card, indent=2, allow_nan=False).encode() + b"\n")
    frame = graph.inputs[0]
    text = _README.format(frame=frame.name, size=frame.shape, control_dt_s=policy.spec.control_dt_s)
    write_atomic(folder / README, text.encode())


def _as_torch(policy: Policy) -> TorchPolicy[Any]:
    if not isinstance(policy, TorchPolicy):
        found = type(policy).__name__
        raise Unimplemented(f"A policy to export must be a network; got {found}.", hint="Export another model.")
    return policy


def _goals(spec: PolicySpec, more: Sequence[str]) -> tuple[str, ...]:
    """Returns the goals of a graph: skills, or texts, those of training first; none for goal images."""
    if more and spec.goal_form != "text":
        raise InvalidInput(
            f"Goal texts must be given for a policy that follows texts; this one follows {spec.goal_form}.",
            field="goal_text",
            hint="Leave them out.",
        )
    goals = spec.skills or spec.goal_texts or spec.training_texts
    return tuple(dict.fromkeys((*goals, *(str(parse_text(spec, text).content) for text in more))))


def _entry(graph: PolicyGraph, spec: PolicySpec) -> Mapping[str, Any]:
    """Returns the card's entry on the graph."""
    left_out = [
        "Images of other sizes: frames must have the size of the input.",
        f"Sequences of goals and the limit of {spec.max_steps_per_goal} steps: begin another goal with a state of 0.",
        "Steps without an observation: run the graph at every control step.",
    ]
    if spec.training_texts:
        left_out.append(
            "Reading of goal texts: the graph follows those of `goals`; --goal-text of the export adds more."
        )
    if not spec.predicts_reached:
        left_out.append("`goal_reached` and `goal_confidence`: this policy does not see whether its goal is reached.")
    return {
        "file": GRAPH,
        "inputs": [asdict(each) for each in graph.inputs],
        "outputs": [{k: v for k, v in asdict(each).items() if k != "start"} for each in graph.outputs],
        "goals": list(graph.goals),
        "checked": f"Outputs for random frames are the policy's own, within {TOLERANCE:g}; `in_distribution`, a rank, "
        "may be a step away.",
        "left_out": left_out,
    }
