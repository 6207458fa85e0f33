"""Exports the labels of a dataset to files of other programs."""

from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.cli.segments.webvtt import webvtt
from freerein.data import Dataset
from freerein.data.label_segments import read_label_segments, to_csv
from freerein.data.lerobot_export import export_labels
from freerein.errors import InvalidInput


def export_labels_to(
    root: Path, *, lerobot: Path | None, csv: Path | None, vtt: Path | None, replaces: bool
) -> dict[str, Path]:
    """Writes the labels of a dataset in the forms that have a path; returns the paths by form.

    Raises:
        InvalidInput: No form has a path, or as `freerein.data.lerobot_export.export_labels`.
        FailedPrecondition: The dataset was not labelled.
    """
    written = {form: path for form, path in (("lerobot", lerobot), ("csv", csv), ("vtt", vtt)) if path}
    if not written:
        raise InvalidInput(
            "A form must be chosen; got none.",
            field="lerobot",
            hint="Write --lerobot ORIGINAL, --csv FILE or --vtt FOLDER.",
        )
    dataset = Dataset(root)
    segments = read_label_segments(root, dataset)
    if lerobot is not None:
        export_labels(root, lerobot, replaces=replaces)
    if csv is not None:
        write_atomic(csv, to_csv(segments).encode())
    if vtt is not None:
        fps = dataset.spec.fps
        for index, some in enumerate(segments):
            cues = [(each.start / fps, each.end / fps, each.skill) for each in some if each.skill]
            write_atomic(vtt / f"trajectory-{index:03}.vtt", webvtt(cues).encode())
    return written
