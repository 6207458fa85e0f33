"""A dataset's contents, and the cost of a fit to it, in words."""

import math

from freerein.cli.times import duration
from freerein.data import DatasetSummary, FitPrediction

_MOST_GOAL_TEXTS = 6


def takes(fit: FitPrediction) -> str:
    """Returns what a fit takes, as the end of a sentence whose subject is its command."""
    height, width, _ = fit.frame
    memory_gb, disk_gb = (math.ceil(10 * each) / 10 for each in (fit.memory_gb, fit.disk_gb))
    return (
        f"sees frames of {height}x{width} of the camera {fit.camera}. It takes about "
        f"{duration(60 * math.ceil(fit.minutes))}, by a plain estimate for one core of a CPU; at most "
        f"{memory_gb:.1f} GB of memory for the frames of a batch; and {disk_gb:.1f} GB of disk for decoded frames."
    )


def _goal_texts(summary: DatasetSummary) -> str:
    """Returns the trajectories' own goal texts, most frequent first."""
    counts = sorted(summary.goal_text_counts.items(), key=lambda entry: -entry[1])
    own = [f"{text} ({count})" for text, count in counts if text != summary.spec.task]
    return (
        "; ".join([*own[:_MOST_GOAL_TEXTS], *(["..."] if len(own) > _MOST_GOAL_TEXTS else [])]) or "none of their own"
    )


def summary_rows(name: str, summary: DatasetSummary) -> list[tuple[str, str]]:
    """Returns a dataset's properties and their values."""
    spec = summary.spec
    cameras = ", ".join(f"{camera} {'x'.join(map(str, size))}" for camera, size in spec.cameras.items())
    unit = "in [-1, 1]" if spec.has_scaled_actions else "in their own unit"
    action = f"{spec.action.choices} choices" if spec.action.choices else f"{spec.action.size} numbers {unit}"
    return [
        ("dataset", name),
        ("task", spec.task),
        ("goal texts", _goal_texts(summary)),
        ("trajectories", f"{summary.trajectories}, of {summary.shortest} to {summary.longest} timesteps"),
        ("timesteps", f"{summary.frames}, {summary.duration_s / 60:.1f} minutes at {spec.fps} Hz"),
        ("cameras", cameras),
        ("action", action),
        (
            "robot state",
            f"{spec.robot_state_size} numbers, read by `use_robot_state`" if spec.robot_state_size else "none",
        ),
        ("skills", ", ".join(f"{skill} ({count})" for skill, count in summary.skill_counts.items()) or "none"),
        ("terminations", "known" if spec.has_terminations else "unknown"),
        ("untagged", str(summary.untagged)),
        ("true labels", str(summary.labelled)),
        ("size", f"{summary.data_bytes / 1e6:.1f} MB"),
        ("fingerprint", summary.fingerprint),
    ]
