"""Writes the scene with the real LeRobot, several trajectories to a file, of images and of video.

Usage: write_theirs.py ROOT.
"""

import sys
from pathlib import Path

import scene
from lerobot.datasets.lerobot_dataset import LeRobotDataset

NUMBERS = {
    "next.done": {"dtype": "bool", "shape": (1,), "names": None},
    "observation.state": {"dtype": "float32", "shape": (len(scene.STATE_NAMES),), "names": list(scene.STATE_NAMES)},
    "action": {"dtype": "float32", "shape": (len(scene.ACTION_NAMES),), "names": list(scene.ACTION_NAMES)},
}


def write(root: Path, *, use_videos: bool) -> None:
    size = scene.VIDEO_SIZE if use_videos else scene.SIZES["front"]
    camera = {
        "dtype": "video" if use_videos else "image",
        "shape": size,
        "names": ["height", "width", "channels"],
    }
    dataset = LeRobotDataset.create(
        "freerein/compat",
        root=root,
        fps=scene.FPS,
        robot_type="arm",
        features={"observation.images.front": camera, **NUMBERS},
        use_videos=use_videos,
        video_backend="pyav",
    )
    for index, length in enumerate(scene.LENGTHS):
        frames = scene.moving_bar(index) if use_videos else scene.frames(index, "front")
        for t in range(length):
            dataset.add_frame(
                {
                    "observation.images.front": frames[t],
                    "next.done": scene.terminations(index)[t : t + 1],
                    "observation.state": scene.states(index)[t],
                    "action": scene.actions(index)[t],
                    "task": scene.TASKS[index],
                }
            )
        dataset.save_episode()
    dataset.finalize()


write(Path(sys.argv[1]) / "images", use_videos=False)
write(Path(sys.argv[1]) / "video", use_videos=True)
