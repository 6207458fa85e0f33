"""The pictures of a session, drawn while its services run."""

from collections.abc import Mapping
from pathlib import Path

from experiments.first_session.record import Record
from experiments.workbench.plots import png
from freerein.cli.connection import channel_to
from freerein.cli.demo import pictures
from freerein.cli.demo.evaluations import filmstrip, filmstrip_failure, labelled_trajectory, reward_examples
from freerein.cli.demo.pictures import RewardExample
from freerein.cli.settings import CliSettings
from freerein.clients import RewardClient

_SCENES = {"two-blocks": (0, 1, 2, 4), "four-blocks": (0, 4)}
"""Places of the captions in their group whose scenes are shown, by step."""


async def draw(record: Record, folder: Path, addresses: Mapping[str, str]) -> None:
    """Writes the pictures to a folder; `addresses` are those of the services."""
    for task in ("grid", "blocks"):
        labelled = labelled_trajectory(record.evaluation(f"{task}-labels"))
        figure = pictures.timeline_figure(labelled, task=task)
        (folder / f"timeline-{task}.png").write_bytes(png(figure))
    examples = await _reward_examples(record, addresses["reward"])
    shown = "first held-out image of each relation, of two blocks and of four"
    (folder / "rewards.png").write_bytes(png(pictures.rewards_figure(examples, images=shown)))
    landmarks = record.evaluation("landmarks")
    if goals := filmstrip(landmarks):
        figure = pictures.filmstrip_figure(goals, filmstrip_failure(landmarks))
        (folder / "filmstrip.png").write_bytes(png(figure))


async def _reward_examples(record: Record, address: str) -> list[RewardExample]:
    async with RewardClient(channel_to(address, CliSettings())) as client:
        return [
            example
            for step, captions in _SCENES.items()
            for example in await reward_examples(record.evaluation(step), client, captions=captions)
        ]
