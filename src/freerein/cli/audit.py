"""Audits of reward models: what people say of some images, beside what the model rewards.

    DIR/audit.csv        image,text,holds
                         kitchen/0.png,a red cup to the left of a blue cup,yes
    DIR/kitchen/0.png

Nothing else tells precision and recall of a reward: the figures of its fit are of the captions that it learned from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from freerein.cli.commands.image_files import read_images
from freerein.cli.connection import call
from freerein.cli.output import print_json
from freerein.cli.tables import show_table
from freerein.clients import RewardClient
from freerein.clients.request_slices import request_slices
from freerein.data.annotation_table import lines
from freerein.errors import InvalidInput, must_be, quoted
from freerein.metrics import wilson_interval
from freerein.types.common import Image, ModelRef
from freerein.types.reward import RewardRequest

TABLE = "audit.csv"

Audit = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help=f"Folder of images and `{TABLE}`, what people say of them: precision and recall."),
]

_COLUMNS = ("image", "text", "holds")
_ANSWERS: Mapping[str, bool] = {"yes": True, "no": False}
_OF_TEXTS = ("goal_text", "rivals")
"""Fields of a refusal that is about the text; others are about the images."""


@dataclass(frozen=True)
class Answer:
    """A person's answer: whether an image shows what a text says."""

    image: Image
    text: str
    holds: bool


@dataclass(frozen=True)
class Rate:
    """A share of some answers, with its 95 % interval by Wilson's score; None where there are none."""

    value: float | None
    low: float | None
    high: float | None
    of: int

    @classmethod
    def over(cls, count: int, of: int) -> "Rate":
        """Returns the rate of a count of some."""
        return cls(count / of, *wilson_interval(count, of), of) if of else cls(None, None, None, 0)

    def __str__(self) -> str:
        if self.value is None:
            return "none"
        return f"{100 * self.value:.0f} % [{100 * (self.low or 0):.0f}, {100 * (self.high or 0):.0f}] of {self.of}"


@dataclass(frozen=True)
class Report:
    """The findings of an audit.

    Attributes:
        precision: Of the rewarded images, those that show the text.
        recall: Of the images that show the text, the rewarded ones.
        false_positives: Of the images that do not show it, the rewarded ones.
        holds: Of all, those that show the text: the precision of a reward that is always given.
        unknown: Words of the texts that the model does not know.
        refused: Texts that the model cannot be asked, which count as never rewarded.
    """

    model: ModelRef
    precision: Rate
    recall: Rate
    false_positives: Rate
    holds: Rate
    unknown: tuple[str, ...]
    refused: tuple[str, ...]


def check_cameras(cameras: object) -> None:
    """Raises InvalidInput for a model of several cameras: a line of the table names one image."""
    if isinstance(cameras, list) and len(cameras) > 1:
        got, hint = quoted(", ".join(map(str, cameras))), "Leave out --audit, or fit to one camera: --set cameras=NAME."
        raise must_be("--audit", "of a model of one camera", got, field="audit", hint=hint)


def read_answers(folder: Path) -> list[Answer]:
    """Returns the answers in a folder's table.

    Raises:
        InvalidInput: There is no table, or a line of it is not as above; the error names line and column.
        NotFound: An image is missing.
        UnsupportedMedia: One is no image.
    """
    path = folder / TABLE
    if not path.is_file():
        raise must_be("audit", f"a folder with `{TABLE}`", "none", hint=f"Its first line is {','.join(_COLUMNS)}.")
    answers = []
    for line in lines(path.read_bytes(), _COLUMNS, hint="Put a text with commas in double quotes."):
        said = line.cells["holds"].strip().lower()
        if said not in _ANSWERS:
            raise line.error("holds", "be yes or no; got another word", "Leave out what nobody can tell.")
        if not line.cells["text"].strip():
            raise line.error("text", "say what the image may show; it is empty", "Use goal texts of your tasks.")
        (image,) = _image(folder, line.cells["image"].strip(), number=line.number)
        answers.append(Answer(image, line.cells["text"].strip(), _ANSWERS[said]))
    if not answers:
        raise must_be(TABLE, "at least one answer below its first line", "none", field="audit", hint="Add some.")
    return answers


def _image(folder: Path, name: str, *, number: int) -> Sequence[Image]:
    if not name or not (folder / name).is_file():
        raise InvalidInput(
            f"Line {number}, column `image`, must name a file below the folder; got {quoted(name)}.",
            field="image",
            hint="Write kitchen/0.png for DIR/kitchen/0.png.",
        )
    return read_images([str(folder / name)])


def audit(answers: Sequence[Answer], model: ModelRef) -> Report:
    """Returns what a reward model says of the images, beside the answers.

    Raises:
        InvalidInput: The reward service refuses all texts.
        ServiceError: The reward service refuses, or cannot be reached.
    """

    async def ask(client: RewardClient) -> Report:
        rewarded, unknown, refused, used = [False] * len(answers), list[str](), dict[str, InvalidInput](), model
        texts = dict.fromkeys(each.text for each in answers)
        for text in texts:
            places = [place for place, each in enumerate(answers) if each.text == text]
            for part in request_slices([(answers[place].image,) for place in places]):
                some = places[part]
                request = RewardRequest(text, images=tuple(answers[place].image for place in some), model=model)
                try:
                    reply = await client.reward(request)
                except InvalidInput as error:
                    if error.field not in _OF_TEXTS:
                        raise
                    refused[text] = error
                    break
                for place, reward in zip(some, reply.rewards.tolist(), strict=True):
                    rewarded[place] = reward > 0
                used, unknown = reply.model, [*unknown, *reply.unknown]
        if len(refused) == len(texts):
            raise next(iter(refused.values()))
        return _report(rewarded, [each.holds for each in answers], used, unknown=unknown, refused=tuple(refused))

    return call(RewardClient, "reward", ask)


def _report(
    rewarded: Sequence[bool],
    holds: Sequence[bool],
    model: ModelRef,
    *,
    unknown: Sequence[str],
    refused: tuple[str, ...],
) -> Report:
    pairs = list(zip(rewarded, holds, strict=True))
    right, given, true = sum(a and b for a, b in pairs), sum(rewarded), sum(holds)
    return Report(
        model,
        precision=Rate.over(right, given),
        recall=Rate.over(right, true),
        false_positives=Rate.over(given - right, len(pairs) - true),
        holds=Rate.over(true, len(pairs)),
        unknown=tuple(dict.fromkeys(unknown)),
        refused=refused,
    )


def show(report: Report, *, as_json: bool) -> None:
    """Prints a report."""
    if as_json:
        document: dict[str, Any] = {"audit": asdict(report)}
        print_json(document)
        return
    rates = {
        "precision: rewarded images that show the text": report.precision,
        "recall: images that show the text that are rewarded": report.recall,
        "false positives: images that do not show it that are rewarded": report.false_positives,
        "base rate: precision of a reward that is always given": report.holds,
    }
    show_table(("audit", "share [95 % interval]"), [(name, str(rate)) for name, rate in rates.items()], last="wrapped")
    typer.echo(f"model {report.model.name} {report.model.version}")
    if report.unknown:
        typer.echo(f"The model does not know {', '.join(report.unknown)}: texts with these words are never rewarded.")
    for text in report.refused:
        typer.echo(f"The model cannot be asked {quoted(text)}: it counts as never rewarded.")
