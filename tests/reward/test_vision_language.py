"""Vision-language models that were trained elsewhere: OpenAI's layout, transformers, and their import."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from tests.reward import clip_layout
from torch import Tensor

from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_reward import import_model, pretrain
from freerein_reward.methods import load
from freerein_reward.model import KNOWN, GradCamModel, ImportedGrounding, contrast_texts, load_built_in, load_grounding
from freerein_reward.model.vision_language import KEYPOINTS, BuiltIn, gradient_weights, heat_maps
from freerein_reward.model.vision_language.openai_clip import OpenAIClip, clip_shape, load_openai_clip
from freerein_reward.model.vision_language.openai_network import Clip
from freerein_reward.training import synthetic_objects
from freerein_reward.training.import_calibration import calibrate

SHIPPED = Path(__file__).parents[2] / "models" / "reward"
PHRASES = ("a red block", "a blue block", "a yellow thing")
CPU = torch.device("cpu")
IMAGE = torch.arange(64 * 64 * 3).remainder(251).to(torch.uint8).view(1, 64, 64, 3)


@pytest.fixture(scope="module")
def shipped() -> GradCamModel:
    store = ModelStore(SHIPPED)
    return load_built_in(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clip_layout.write(tmp_path_factory.mktemp("clip"), clip_layout.random_weights())


@pytest.fixture(scope="module")
def clip(source: Path) -> OpenAIClip:
    return load_openai_clip(source, CPU)


def objects(count: int) -> Tensor:
    """Returns synthetic images, uint8 (N, 64, 64, 3)."""
    rendered = [synthetic_objects.render(np.random.default_rng((7, at)))[0] for at in range(count)]
    return torch.from_numpy(np.stack(rendered))


def normalised(heat: Tensor) -> Tensor:
    return heat / heat.amax(dim=(2, 3), keepdim=True).clamp(min=1e-12)


@pytest.mark.parametrize("place", KEYPOINTS)
def test_a_peak_is_found_where_it_is_and_a_flat_map_somewhere(place: str) -> None:
    at = torch.tensor([[0.3, 0.7]])  # x and y
    rows, columns = torch.meshgrid(*2 * [(torch.arange(14) + 0.5) / 14], indexing="ij")
    heat = torch.exp(-((columns - at[0, 0]) ** 2 + (rows - at[0, 1]) ** 2) / 0.01)[None, None]
    found = KEYPOINTS[place](torch.cat([heat, torch.zeros_like(heat)], dim=1))
    assert (found[0, 0] - at[0]).abs().max() < 1 / 14
    assert ((found >= 0) & (found <= 1)).all()


@pytest.mark.parametrize("name", ["built in", "openai"])
def test_the_closed_form_is_grad_cam_by_gradient(shipped: GradCamModel, clip: OpenAIClip, name: str) -> None:
    model = shipped.vision_language if name == "built in" else clip
    images = objects(8)
    with torch.inference_mode():
        directions = contrast_texts(model.embed_texts(PHRASES))
        closed = heat_maps(model, images, directions)
        maps, weights = gradient_weights(model, images, directions)
        by_gradient = torch.einsum("npc,nchw->nphw", weights, maps).relu()
    assert (closed.amax(dim=(2, 3)) > 0).any(dim=0).all()
    torch.testing.assert_close(normalised(by_gradient), normalised(closed), atol=1e-5, rtol=0)
    torch.testing.assert_close(model.traced_maps(images).embeddings, model.embed_images(images), atol=1e-6, rtol=0)


def test_the_network_has_the_names_and_shapes_that_openai_published() -> None:
    shapes = clip_layout.published(**clip_layout.RN50)
    with torch.device("meta"):
        network = Clip(clip_shape({name: torch.empty(shape) for name, shape in shapes.items()}))
    assert {name: tuple(each.shape) for name, each in network.state_dict().items()} == shapes


def test_a_small_model_embeds_as_open_clip_does(clip: OpenAIClip) -> None:
    with torch.inference_mode():
        image, text = clip.embed_images(IMAGE)[0, :4], clip.embed_texts(["A RED block"])[0, :4]
    assert image.tolist() == pytest.approx([-0.2104, -0.0723, -0.1785, 0.1791], abs=1e-4)
    assert text.tolist() == pytest.approx([0.3025, -0.1702, -0.2235, -0.1763], abs=1e-4)
    assert clip.truncated(["a red block", "red " * 14, "red " * 15]).tolist() == [False, False, True]


def test_half_precision_and_the_archives_own_numbers_are_read_too(
    source: Path, clip: OpenAIClip, tmp_path: Path
) -> None:
    halves = {
        name: each.half() if each.is_floating_point() else each for name, each in clip_layout.random_weights().items()
    }
    numbers = {name: torch.tensor(64) for name in ("input_resolution", "context_length", "vocab_size")}
    again = load_openai_clip(clip_layout.write(tmp_path, halves | numbers), CPU)
    torch.testing.assert_close(again.embed_images(IMAGE), clip.embed_images(IMAGE), atol=0.01, rtol=0)


# --- the import


def sha256(folder: Path) -> str:
    return hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()


def run_import(source: Path, models: Path, digest: str = "", *options: str) -> int:
    given = digest or sha256(source)
    return import_model.main([str(source), str(models), "--sha256", given, "--images", "64", *options])


def test_an_imported_model_is_the_grounding_model(
    source: Path, clip: OpenAIClip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_import(source, tmp_path, "", "--place", "soft_argmax") == 0
    assert "Warning: The model tells the colour" in capsys.readouterr().out  # its weights are random
    store = ModelStore(tmp_path)
    folder = store.folder(ModelRef("grounding", store.active_version("grounding")))
    model = load(folder, "cpu")
    assert isinstance(model, ImportedGrounding)
    assert folder.stat().st_mode == folder.parent.stat().st_mode  # a service of another user may read it
    assert (model.place, model.image_size, model.preprocess(np.zeros((5, 7, 1), np.uint8)).shape) == (
        "soft_argmax",
        64,
        (64, 64, 3),
    )
    found = model.locate(objects(2).numpy(), ("a coffee mug", "a red block"))
    assert (found.heatmaps.shape, found.x.shape) == ((2, 2, 2, 2), (2, 2))
    assert np.isfinite(found.presence).all()
    embedded = model.embed_images({"": IMAGE.numpy()}).vectors
    np.testing.assert_allclose(embedded, clip.embed_images(IMAGE).numpy(), atol=1e-6)
    assert [path.name for path in tmp_path.glob("[!.]*")] == ["grounding"]


Damage = Callable[[Path], object]


def weights_of(change: Callable[[dict[str, Tensor]], object]) -> Damage:
    def write(folder: Path) -> None:
        weights = clip_layout.random_weights()
        change(weights)
        clip_layout.write(folder, weights)

    return write


def large(folder: Path) -> None:
    with (folder / "model.safetensors").open("r+b") as file:
        file.truncate(2 * 2**30 + 1)  # sparse


def pickled(folder: Path) -> None:
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")


DAMAGES: dict[str, tuple[Damage, str]] = {
    "missing": (weights_of(lambda w: w.pop("visual.bn1.bias")), "misses visual.bn1.bias"),
    "missing first": (weights_of(lambda w: w.pop("text_projection")), "text_projection"),
    "extra": (weights_of(lambda w: w.update(more=torch.zeros(1))), "has the unknown more"),
    "shape": (weights_of(lambda w: w.update({"ln_final.bias": torch.zeros(63)})), "ln_final.bias (63,) for (64,)"),
    "huge": (weights_of(lambda w: w.update({"visual.conv3.weight": torch.zeros(2**16, 1, 1, 1)})), "another shape"),
    "empty": (lambda folder: (folder / "model.safetensors").write_bytes(b""), "at least 8 bytes"),
    "large": (large, "at most 2 GiB"),
    "pickle": (pickled, "the pickle pytorch_model.bin"),
    "code": (lambda folder: (folder / "modeling.py").write_text("1"), "modeling.py asks"),
    "code named": (
        lambda folder: (folder / "config.json").write_text('{"auto_map": {"AutoModel": "x.Y"}, "model_type": "clip"}'),
        "config.json asks",
    ),
    "another model": (lambda folder: (folder / "config.json").write_text('{"model_type": "bert"}'), "says bert"),
    "a pipe": (lambda folder: ((folder / "merges.txt").unlink(), os.mkfifo(folder / "merges.txt")), "no regular file"),
    "no merges": (lambda folder: (folder / "merges.txt").unlink(), "merges"),
    "few merges": (lambda folder: (folder / "merges.txt").write_text("a b\n"), "6 lines"),
}


@pytest.mark.fault("R8")
@pytest.mark.parametrize(("damage", "said"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_model_is_refused_in_words_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Damage, said: str
) -> None:
    source, models = clip_layout.write(tmp_path / "source", clip_layout.random_weights()), tmp_path / "models"
    damage(source)
    path = source / "model.safetensors"
    digest = sha256(source) if path.exists() and path.stat().st_size < 2**30 else "0" * 64
    assert run_import(source, models, digest) == 1
    message = capsys.readouterr().err
    assert said in message
    assert message.count(". ") >= 1  # a hint, too
    assert not models.exists() or list(models.iterdir()) == []


@pytest.mark.fault("R8")
def test_weights_with_another_digest_are_refused(source: Path, tmp_path: Path, capsys: Any) -> None:
    assert run_import(source, tmp_path / "models", "0" * 64) == 1
    assert sha256(source) in capsys.readouterr().err
    assert not (tmp_path / "models").exists()


def test_what_cannot_be_read_or_written_is_one_line_with_a_remedy(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "models"
    path.write_text("")
    assert run_import(source, path) == 1
    line = capsys.readouterr().err
    assert line.startswith("All files and folders must be") and str(path) in line  # noqa: PT018
    assert line.count("\n") == 1
    with pytest.raises(SystemExit):
        run_import(source, tmp_path, "", "--device", "gpu")
    assert "must be auto, cpu or cuda:N; got `gpu`" in capsys.readouterr().err
    for words, said in ((["lr=abc"], "got `lr=abc`"), (["seed"], "got `seed`"), ([], f"{path} is not: ")):
        with pytest.raises(SystemExit):
            pretrain.main([str(path), *words])
        assert said in capsys.readouterr().err


def test_calibrated_on_drawings_a_model_that_knows_colours_tells_them(shipped: GradCamModel) -> None:
    model = BuiltIn(shipped.network)
    calibration, figures = calibrate(model, images=512, seed=3)
    assert figures["colour_accuracy"] > 0.9
    assert figures["presence_accuracy"] > 0.85
    assert figures["known_colours"] > 0.8
    grounding = ImportedGrounding(model, calibration, place="centroid")
    assert {"red", "blue"} <= {*grounding.names}
    known = grounding.known(("a red block", "a ball", "a coffee mug"))
    assert (known >= KNOWN).tolist() == [True, False, True]  # of shapes it tells little; mugs nobody drew
    images = objects(16).numpy()
    found, expected = grounding.ground(images, PHRASES), shipped.ground(images, PHRASES)
    assert np.array_equal(found.heatmaps, expected.heatmaps)
    assert np.array_equal(found.x, expected.x)


# --- transformers


def save_transformers(folder: Path, kind: str) -> Any:
    """Writes a small random model as transformers saves it, and returns it."""
    transformers = pytest.importorskip(
        "transformers", reason="transformers is not installed: freerein-reward[transformers]"
    )
    from tokenizers import Tokenizer, models, pre_tokenizers, processors

    config_class, model_class = {
        "clip": (transformers.CLIPConfig, transformers.CLIPModel),
        "siglip": (transformers.SiglipConfig, transformers.SiglipModel),
    }[kind]
    small = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2}
    tokens = {"bos_token_id": 2, "eos_token_id": 3, "pad_token_id": 1}
    torch.manual_seed(0)
    network = model_class(
        config_class(
            text_config={**small, **tokens, "vocab_size": 9, "max_position_embeddings": 8, "projection_size": 32},
            vision_config={**small, "image_size": 32, "patch_size": 8},
            projection_dim=16,
        )
    ).eval()
    network.save_pretrained(folder)
    words = ("[UNK]", "[PAD]", "[START]", "[END]", "a", "red", "blue", "block", "thing")
    tokenizer = Tokenizer(models.WordLevel({word: at for at, word in enumerate(words)}, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="[START] $A [END]", special_tokens=[("[START]", 2), ("[END]", 3)]
    )
    tokenizer.save(str(folder / "tokenizer.json"))
    return network


@pytest.mark.parametrize("kind", ["clip", "siglip"])
def test_a_model_of_transformers_embeds_as_the_library_and_has_heat_by_gradient(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    network = save_transformers(source := tmp_path / "source", kind)
    (source / "preprocessor_config.json").write_text(
        json.dumps({"image_mean": [0.5, 0.4, 0.3], "image_std": [0.5] * 3})
    )
    assert run_import(source, tmp_path / "models") == 0, capsys.readouterr().err
    store = ModelStore(tmp_path / "models")
    loaded = load_grounding(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")
    assert isinstance(loaded, ImportedGrounding)
    model, images = loaded.vision_language, objects(3)[:, ::2, ::2]
    with torch.no_grad():
        pixels = (images.permute(0, 3, 1, 2) / 255 - torch.tensor([0.5, 0.4, 0.3]).view(3, 1, 1)) / 0.5
        expected = network.get_image_features(pixels).pooler_output
        ids = torch.tensor([[2, 4, 5, 7, 3, *([3 if kind == "clip" else 1] * 3)]])
        said = network.get_text_features(ids).pooler_output
    torch.testing.assert_close(model.embed_images(images), torch.nn.functional.normalize(expected, dim=1))
    torch.testing.assert_close(model.embed_texts(["A red block."]), torch.nn.functional.normalize(said, dim=1))
    traced = model.traced_maps(images)
    assert traced.maps.shape == (3, 32, 4, 4)
    torch.testing.assert_close(traced.embeddings.detach(), model.embed_images(images))
    assert model.truncated(["a red block", "a red red red red red block"]).tolist() == [False, True]
    found = loaded.ground(images.numpy(), PHRASES)
    assert found.heatmaps.shape == (3, 3, 4, 4)
    assert found.heatmaps.max() == pytest.approx(1)


def missing_weight(folder: Path) -> None:
    weights = safetensors.torch.load_file(folder / "model.safetensors")
    weights.pop("logit_scale")
    safetensors.torch.save_file(weights, folder / "model.safetensors", metadata={"format": "pt"})


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (missing_weight, "missing logit_scale"),
        (lambda folder: (folder / "tokenizer.json").write_text("{}"), "could not be read"),
        (lambda folder: (folder / "tokenizer.json").unlink(), "tokenizer.json"),
        (lambda folder: (folder / "preprocessor_config.json").write_text('{"image_std": [0, 0, 0]}'), "image_std"),
    ],
    ids=["weight", "tokenizer", "no tokenizer", "statistics"],
)
def test_a_damaged_model_of_transformers_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Damage, said: str
) -> None:
    save_transformers(source := tmp_path / "source", "siglip")
    damage(source)
    assert run_import(source, tmp_path / "models") == 1
    assert said in capsys.readouterr().err
    assert list((tmp_path / "models").iterdir()) == []
