"""`freerein segment`: labels the timesteps of a video, of one trajectory, or of a whole dataset with skills."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console

from freerein import wire
from freerein.atomic_files import write_atomic
from freerein.cli.connection import SEGMENT_TIMEOUT_S, call
from freerein.cli.datasets import dataset_root, read_trajectory
from freerein.cli.figure_style import FILM_FRAMES
from freerein.cli.output import AsJson, command, print_json, progress_bar
from freerein.cli.segments import picture, timeline
from freerein.cli.segments.timeline import Timeline
from freerein.cli.segments.webvtt import webvtt
from freerein.clients import SegmentationClient
from freerein.data import Dataset, labels, read_actions, read_choices
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.data.lookup import choose_camera
from freerein.errors import InvalidInput, NotFound, must_be, quoted
from freerein.types.common import ModelRef, Trajectory
from freerein.types.segmentation import ListSkillsRequest, ListSkillsResponse, SegmentRequest, SegmentResponse
from freerein.video import frames_at_rate, open_video

_WRITER = "freerein segment"
_FILM_HEIGHT = 120
_VIDEO, _TRAJECTORY, _DATASET = "a video", "a trajectory of a dataset", "a whole dataset with --save"
_VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov")
_GOES_WITH = {
    "index": (_TRAJECTORY,),
    "camera": (_TRAJECTORY, _DATASET),
    "resize": (_VIDEO,),
    "fps": (_VIDEO,),
    "actions": (_VIDEO,),
    "png": (_VIDEO, _TRAJECTORY),
    "vtt": (_VIDEO, _TRAJECTORY),
    "save": (_DATASET,),
}

_Fps = Annotated[
    float, typer.Option(min=0, max=240, help="Timesteps per second of a video; those of the model by default.")
]
_Actions = Annotated[
    Path | None,
    typer.Option(help="CSV file with the actions of a video, a row per timestep, for models that see them."),
]

Film = Sequence[npt.NDArray[np.uint8]]

app = typer.Typer(add_completion=False)


@app.command()
@command
def segment(
    source: Annotated[str, typer.Argument(help="An mp4 or mov file, or the name of a dataset in the data directory.")],
    *,
    index: Annotated[int | None, typer.Option(min=0, help="Index of the dataset's trajectory; 0 by default.")] = None,
    model: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of the model; the active one by default.")] = "",
    camera: Annotated[str, typer.Option(help="Camera of the dataset's frames; the model's by default.")] = "",
    smoothing: Annotated[float, typer.Option(min=0, help="Standard deviation of smoothing, in timesteps.")] = 0.0,
    min_segment: Annotated[
        int, typer.Option(min=0, max=1000, help="Merge segments shorter than this many timesteps.")
    ] = 0,
    min_kept: Annotated[
        int, typer.Option(min=0, max=1000, help="Reject segments shorter than this many timesteps.")
    ] = 0,
    min_confidence: Annotated[
        float, typer.Option(min=0, max=1, help="Reject timesteps with a smaller confidence; before `--min-kept`.")
    ] = 0.0,
    resize: Annotated[bool, typer.Option("--resize", help="Resize a video's frames to the model's size.")] = False,
    fps: _Fps = 0.0,
    actions: _Actions = None,
    png: Annotated[Path | None, typer.Option(help="Draw the timeline into this PNG file.")] = None,
    vtt: Annotated[Path | None, typer.Option(help="Write the segments to this WebVTT file, as subtitles.")] = None,
    save: Annotated[bool, typer.Option("--save", help="Label the whole dataset and store the labels.")] = False,
    as_json: AsJson = False,
) -> None:
    """Label every timestep of a video or a trajectory with a skill; with --save, of a whole dataset."""
    request = SegmentRequest(
        ModelRef(model, version),
        min_segment=min_segment,
        smoothing=smoothing,
        min_kept=min_kept,
        min_confidence=min_confidence,
    )
    given = {"index": index is not None, "camera": camera, "resize": resize, "fps": fps, "actions": actions}
    given |= {"png": png, "vtt": vtt, "save": save}
    if source.lower().endswith(_VIDEO_SUFFIXES):
        _check_all_go_with(_VIDEO, given)
        labelled, film = _segment_video(
            Path(source), replace(request, resize=resize, fps=fps), actions, is_drawn=png is not None
        )
    else:
        if Path(source).is_file():
            hint = "Encode it: ffmpeg -i IN -c:v libx264 OUT.mp4."
            raise must_be("source", "an mp4 or mov file, or the name of a dataset", "another file", hint=hint)
        _check_all_go_with(_DATASET if save else _TRAJECTORY, given)
        opened = Dataset(dataset_root(source))
        if save:
            _segment_all(source, opened, request, camera, as_json=as_json)
            return
        labelled, film = _segment_one(opened, index or 0, request, camera)
    if png is not None:
        picture.draw(png, labelled, film)
    if vtt is not None:
        write_atomic(vtt, webvtt(labelled.cues).encode())
    if as_json:
        print_json({**wire.to_json(labelled.answer), "flagged": timeline.flagged([labelled.answer.in_distribution])})
    else:
        timeline.show(labelled, Console())


def _check_all_go_with(labelled: str, given: Mapping[str, object]) -> None:
    """Raises InvalidInput for an option that is not of what is labelled; it would be ignored."""
    for option, forms in _GOES_WITH.items():
        if given[option] and labelled not in forms:
            name, rule = f"--{option}", f"given for {' or '.join(forms)}"
            raise must_be(name, rule, labelled, field=option, hint=f"Leave out --{option}.")


def _segment_video(
    path: Path, request: SegmentRequest, actions: Path | None, *, is_drawn: bool
) -> tuple[Timeline, Film]:
    """Returns the labelled video, and some of its frames where they are to be drawn."""
    if not path.is_file():
        raise NotFound(
            f"The video must be an mp4 or mov file; there is no file {quoted(str(path))}.",
            field="source",
            hint="Give its path, relative to the current folder.",
        )

    filled = replace(request, video=path.read_bytes())

    async def ask(client: SegmentationClient) -> SegmentResponse:
        asked = filled
        if actions is not None:
            skills = await client.list_skills(ListSkillsRequest(request.model))
            asked = replace(filled, model=skills.model, actions=_read_actions(actions, skills))
        return await client.segment(asked, timeout_s=SEGMENT_TIMEOUT_S)

    answer = call(SegmentationClient, "segmentation", ask)
    return timeline.of_video(answer), _film_of(path, answer) if is_drawn else ()


def _read_actions(path: Path, skills: ListSkillsResponse) -> npt.NDArray[Any]:
    """Returns the actions of a CSV file, (T, A), in the model's dtype."""
    if not path.is_file():
        raise InvalidInput(
            f"The actions must be a CSV file; there is no file {quoted(str(path))}.",
            field="actions",
            hint="Name the file.",
        )
    if skills.action_choices:
        return read_choices(path.read_bytes(), file=path.name, choices=skills.action_choices)
    _, values = read_actions(path.read_bytes(), file=path.name)
    return values.astype(np.float32)


def _film_of(path: Path, answer: SegmentResponse) -> Film:
    """Returns frames of a labelled video at equal distances, scaled to the height of a film."""
    with open_video(path) as probe:
        info = probe.info
    size = (_FILM_HEIGHT, max(1, round(info.width * _FILM_HEIGHT / info.height)))
    count = len(answer.labels)
    shown = set(_film_indices(count))
    with open_video(path, size=size) as video:
        timesteps = frames_at_rate(video, fps=answer.fps, file=path.name) if answer.fps else iter(video)
        return [frame.pixels for t, frame in enumerate(islice(timesteps, count)) if t in shown]


def _film_indices(count: int) -> list[int]:
    return [int(t) for t in np.linspace(0, count - 1, min(count, FILM_FRAMES))]


def _segment_one(dataset: Dataset, index: int, request: SegmentRequest, camera: str) -> tuple[Timeline, Film]:
    """Returns a labelled trajectory, and some of its frames; `camera` may be empty."""
    trajectory = read_trajectory(dataset, index)

    async def ask(client: SegmentationClient) -> tuple[SegmentResponse, ListSkillsResponse, str]:
        skills = await client.list_skills(ListSkillsRequest(request.model))
        chosen = choose_camera(dataset, camera, of_model=skills.camera)
        filled = replace(request, model=skills.model, frames=trajectory.frames[chosen], actions=trajectory.actions)
        return await client.segment(filled, timeout_s=SEGMENT_TIMEOUT_S), skills, chosen

    answer, skills, chosen = call(SegmentationClient, "segmentation", ask)
    frames = trajectory.frames[chosen]
    film = [frames[t] for t in _film_indices(len(frames))]
    labelled = timeline.at_rate(answer, fps=dataset.spec.fps)
    return replace(labelled, note=timeline.rate_warning(dataset.spec.fps, skills.fps)), film


def _segment_all(name: str, dataset: Dataset, request: SegmentRequest, camera: str, *, as_json: bool) -> None:
    with progress_bar(f"labelling {name}", total=len(dataset), is_shown=not as_json) as on_count:
        labelled = call(
            SegmentationClient,
            "segmentation",
            lambda client: label_all(client, dataset_root(name), request, camera=camera, on_count=on_count),
        )
    _show_saved(name, len(dataset), labelled, as_json=as_json)


@dataclass(frozen=True)
class LabelledDataset:
    """The stored labels of a dataset, and a note where its rate is not that of the model.

    `flagged` is the share of the timesteps that are probably unlike what the model was fitted on.
    """

    info: LabelsInfo
    flagged: float
    note: str = ""


def _show_saved(dataset: str, count: int, labelled: LabelledDataset, *, as_json: bool) -> None:
    info, flagged, folder = labelled.info, labelled.flagged, dataset_root(dataset) / labels.FOLDER
    if as_json:
        model = {"name": info.model.name, "version": info.model.version}
        document = {"dataset": dataset, "labelled": count, "skills": list(info.skills), "model": model}
        print_json({**document, "flagged": flagged, "path": str(folder)})
        return
    typer.echo(f"Labelled {count} trajectories of {dataset} by model {info.model.name} {info.model.version}.")
    typer.echo(f"The labels are in {folder}; freerein dataset export {dataset} writes them for other programs.")
    for text in filter(None, (timeline.warning(flagged), labelled.note)):
        typer.echo(text)


async def label_all(
    client: SegmentationClient,
    root: Path,
    request: SegmentRequest,
    *,
    camera: str,
    on_count: Callable[[int], None],
) -> LabelledDataset:
    """Labels every trajectory of a dataset by one version of a model, and stores the labels beside it.

    The labels count only once all trajectories have theirs. `request` holds model and options; an empty `camera` is the
    model's; `on_count` is called with the number of trajectories labelled.
    """
    skills = await client.list_skills(ListSkillsRequest(request.model))
    info, dataset, scores = LabelsInfo(skills.skills, skills.model), Dataset(root), list[npt.NDArray[np.float32]]()
    chosen = choose_camera(dataset, camera, of_model=skills.camera)

    async def segment(trajectory: Trajectory) -> SegmentResponse:
        frames, actions = trajectory.frames[chosen], trajectory.actions
        filled = replace(request, model=skills.model, frames=frames, actions=actions)
        return await client.segment(filled, timeout_s=SEGMENT_TIMEOUT_S)

    first = await segment(dataset[0])  # a model that takes no such frames leaves the labels that are there
    with LabelsWriter(root, name=_WRITER) as writer:
        for index, trajectory in enumerate(dataset):
            answer = await segment(trajectory) if index else first
            writer.save(index, answer.labels)
            scores.append(answer.in_distribution)
            on_count(index + 1)
        writer.finish(info)
    note = timeline.rate_warning(dataset.spec.fps, skills.fps)
    return LabelledDataset(info, timeline.flagged(scores), note)
