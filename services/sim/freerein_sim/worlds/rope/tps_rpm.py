"""Thin plate spline robust point matching (TPS-RPM) in two dimensions, after Chui and Rangarajan (2003).

It finds which points of two sets belong together, and a thin plate spline that warps the first set onto the second, by
deterministic annealing: at first matches are soft and the spline is stiff, then both become firmer and more flexible
together. All points have a counterpart here, so that there is no row or column of outliers.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
"""float64 (P, 2)."""

_ANNEALING_RATE, _INNER_ITERATIONS, _SINKHORN_ITERATIONS = 0.93, 5, 10
_LAST_TEMPERATURE = 1e-4
_LEAST_SCALE_M = 1e-6
_BENDING, _AFFINE = 1.0, 0.01
"""Weights of the bending energy and of the affine part's distance from the identity, for each unit of temperature and
point (lambda 1 and lambda 2). Points are scaled to a root mean square distance of 1 from their mean."""

_IDENTITY = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Registration:
    """How one set of points was warped onto another.

    Attributes:
        warped: The first set after the warp, float64 (P, 2).
        matches: For each point of the first set the weights of those of the second, float64 (P, Q); rows add up to 1.
        residual_m: Root mean square distance of the warped points from what they are matched with.
        deformation_m: Root mean square distance of the warped points from the first set after the rigid motion that
            comes closest to the warp.
    """

    warped: Points
    matches: npt.NDArray[np.float64]
    residual_m: float
    deformation_m: float

    @property
    def cost_m(self) -> float:
        """The registration cost: 0 where the second set is the first one after a rigid motion."""
        return float(np.hypot(self.residual_m, self.deformation_m))


def register(first: Points, second: Points) -> Registration:
    """Warps points onto others, in metres; the order of neither matters."""
    scale = max(float(np.sqrt(((second - second.mean(axis=0)) ** 2).sum(axis=1).mean())), _LEAST_SCALE_M)
    model, data = (first - first.mean(axis=0)) / scale, (second - second.mean(axis=0)) / scale
    spline, warped = _Spline(model), model
    temperature, matches = float(_squared_distances(model, data).max()), _matches(model, data, _LAST_TEMPERATURE)
    while temperature > _LAST_TEMPERATURE:
        for _ in range(_INNER_ITERATIONS):
            matches = _matches(warped, data, temperature)
            warped = spline.fitted(matches @ data, stiffness=temperature * len(model))
        temperature *= _ANNEALING_RATE
    return Registration(
        warped * scale + second.mean(axis=0),
        matches,
        residual_m=_rms(warped - matches @ data) * scale,
        deformation_m=_rms(warped - _moved_rigidly(model, warped)) * scale,
    )


def _matches(warped: Points, data: Points, temperature: float) -> npt.NDArray[np.float64]:
    """Returns soft matches (equation 3), rows and columns normalised in turn (Sinkhorn), rows last."""
    distances = _squared_distances(warped, data)
    matches = np.exp((distances.min(axis=1, keepdims=True) - distances) / (2 * temperature))
    for _ in range(_SINKHORN_ITERATIONS):
        matches = matches / (matches.sum(axis=0) + np.finfo(float).tiny) * (len(warped) / len(data))
        matches = matches / (matches.sum(axis=1, keepdims=True) + np.finfo(float).tiny)
    return np.asarray(matches)


class _Spline:
    """Thin plate splines of fixed points, fitted by a QR decomposition (equations 9 to 12)."""

    def __init__(self, points: Points) -> None:
        distances = _squared_distances(points, points)
        self._kernel = 0.5 * distances * np.log(np.where(distances > 0, distances, 1))  # r^2 log r
        self._affine = np.column_stack([np.ones(len(points)), points])
        orthogonal, upper = np.linalg.qr(self._affine, mode="complete")
        self._along, self._across, self._upper = orthogonal[:, :3], orthogonal[:, 3:], upper[:3]

    def fitted(self, targets: Points, *, stiffness: float) -> Points:
        """Returns the points of the spline that warps them towards the targets."""
        across, upper = self._across, self._upper
        bending = across.T @ self._kernel @ across + _BENDING * stiffness * np.eye(across.shape[1])
        weights = across @ np.linalg.solve(bending, across.T @ targets)
        held = _AFFINE * stiffness
        rest = upper.T @ (self._along.T @ (targets - self._kernel @ weights))
        affine = np.linalg.solve(upper.T @ upper + held * np.eye(3), rest + held * _IDENTITY)
        return np.asarray(self._affine @ affine + self._kernel @ weights)


def _moved_rigidly(points: Points, targets: Points) -> Points:
    """Returns the points, turned and moved to where they are closest to their targets."""
    about, goal = points - points.mean(axis=0), targets - targets.mean(axis=0)
    cosine = float((about * goal).sum())
    sine = float((about[:, 0] * goal[:, 1] - about[:, 1] * goal[:, 0]).sum())
    length = max(float(np.hypot(cosine, sine)), np.finfo(float).tiny)
    turn = np.array([[cosine, sine], [-sine, cosine]]) / length
    return np.asarray(about @ turn + targets.mean(axis=0))


def _squared_distances(first: Points, second: Points) -> npt.NDArray[np.float64]:
    return np.asarray(((first[:, None] - second[None]) ** 2).sum(axis=-1))


def _rms(offsets: Points) -> float:
    return float(np.sqrt((offsets**2).sum(axis=1).mean()))
