"""Makes the demonstration that the page shows first: a trajectory of a world, already segmented by a shipped model.

    python web/tools/demonstration.py localhost:9104 localhost:9101

asks running sim and segmentation services. It writes `src/demonstration/frames.webp`, the frames as tiles of one image,
and `src/demonstration/labels.json`. A model sees frames of its own size; larger ones of the same trajectory are shown.
"""

import io
import json
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from freerein.clients import Channel, SegmentationClient, SimClient, SyncClient
from freerein.types.common import ModelRef
from freerein.types.segmentation import SegmentRequest
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksRequest

_FOLDER = Path(__file__).parents[1] / "src/demonstration"
_TASK, _SEED, _INDEX = "bins", 11, 1
_SHOWN_SIDE = 176
_COLUMNS = 10
_MOST_BYTES = 145_000


def main(sim_address: str, segmentation_address: str) -> None:
    """Records, segments and writes the demonstration."""
    with SyncClient(SimClient(Channel(sim_address))) as sim:
        seen, shown = (_record(sim, side) for side in (0, _SHOWN_SIDE))
        task = next(each for each in sim.list_tasks(ListTasksRequest()).tasks if each.name == _TASK)
    (frames,), (pictures,) = seen.trajectory.frames.values(), shown.trajectory.frames.values()
    if not np.array_equal(seen.trajectory.actions, shown.trajectory.actions):
        raise SystemExit("The two recordings must have equal actions; they differ.")
    with SyncClient(SegmentationClient(Channel(segmentation_address))) as segmentation:
        request = SegmentRequest(
            model=ModelRef(_TASK), frames=frames, actions=seen.trajectory.actions, smoothing=1.0, min_segment=2
        )
        answer = segmentation.segment(request)
    labels = {
        "world": _TASK,
        "fps": 1 / task.control_dt_s,
        "columns": _COLUMNS,
        "side": _SHOWN_SIDE,
        "model": {"name": answer.model.name, "version": answer.model.version},
        "skills": list(answer.skills),
        "segments": [{"start": each.start, "end": each.end, "skill": each.skill} for each in answer.segments],
        "confidence": [round(float(each), 3) for each in answer.confidence],
        "in_distribution": [round(float(each), 3) for each in answer.in_distribution],
    }
    _FOLDER.mkdir(parents=True, exist_ok=True)
    (_FOLDER / "frames.webp").write_bytes(_encode(_tiles(pictures)))
    (_FOLDER / "labels.json").write_text(json.dumps(labels, separators=(",", ":")) + "\n")


def _record(sim: SyncClient, side: int) -> DemonstrateResponse:
    """Returns the trajectory with frames of a side in pixels; 0 means the camera's own."""
    request = DemonstrateRequest(
        _TASK, "expert", max_skills=4, count=3, seed=_SEED, first=_INDEX, height=side, width=side
    )
    return next(iter(sim.demonstrate(request)))


def _tiles(frames: npt.NDArray[np.uint8]) -> Image.Image:
    """Returns frames (T, H, W, 3) as tiles, row by row."""
    missing = -len(frames) % _COLUMNS
    padded = np.concatenate([frames, np.zeros((missing, *frames.shape[1:]), np.uint8)])
    grid = padded.reshape(-1, _COLUMNS, *frames.shape[1:]).swapaxes(1, 2)
    rows, height, columns, width, channels = grid.shape
    return Image.fromarray(grid.reshape(rows * height, columns * width, channels))


def _encode(image: Image.Image) -> bytes:
    """Returns a WebP file of the best quality that is small enough."""
    for quality in range(70, 4, -3):
        file = io.BytesIO()
        image.save(file, "webp", quality=quality, method=6)
        if file.tell() <= _MOST_BYTES:
            return file.getvalue()
    raise SystemExit(f"The frames must fit into {_MOST_BYTES} bytes; at the least quality they do not.")


if __name__ == "__main__":
    main(*sys.argv[1:])
