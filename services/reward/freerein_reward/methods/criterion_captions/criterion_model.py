"""Inference with a model of criteria: numpy in, numpy out."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import torch

from freerein.goal_text import Grammar
from freerein_reward.methods.criterion_captions.network import CriterionNetwork
from freerein_reward.model import ImageEmbeddings, PhraseLocations, channels_last, heat_of_presence, preprocess

_MOMENTS_AT_ONCE = 16
_CELL_PIXELS = 4


class CriterionModel:
    """Embeds, compares and locates with a trained network: a `RewardModel` and `GroundingModel` of the core."""

    def __init__(self, network: CriterionNetwork) -> None:
        self.network = channels_last(network.eval())
        self.cameras, units = network.spec.cameras, network.spec.units
        self.aspects: Mapping[str, float] = {
            name: units[2 * place] / units[2 * place + 1] for place, name in enumerate(self.cameras)
        }
        self.grammar: Grammar = network.grammar
        side = network.spec.image_size // _CELL_PIXELS
        self._cells = (len(self.cameras), side, side, network.spec.phrase_dim)

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the network's input, uint8 (H, W, 3)."""
        return preprocess(image, size=self.network.spec.image_size)

    @torch.inference_mode()
    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        """Returns the cells of frames by camera, uint8 (N, H, W, 3), as vectors, float32 (N, V * h * w * D)."""
        moments = np.stack([views[camera] for camera in self.cameras], axis=1)  # (N, V, H, W, 3)
        parts = [part.to(self.network.device) for part in torch.split(torch.from_numpy(moments), _MOMENTS_AT_ONCE)]
        vectors = torch.cat([self.network.embed_cells(part).flatten(start_dim=1) for part in parts])
        distances = torch.cat(list(map(self.network.distance, parts)))
        return ImageEmbeddings(vectors.cpu().numpy(), distances.cpu().numpy())

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns embeddings, float32 (K, D), 0 for a text that is no caption, and that none was truncated, (K,)."""
        embeddings = self.network.embed_captions([self.network.grammar.caption(text) for text in texts])
        return embeddings.cpu().numpy(), np.zeros(len(texts), np.bool_)

    @torch.inference_mode()
    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns the cosine similarity of what images show and what texts say, float32 (N, K)."""
        device = self.network.device
        goals, found = torch.from_numpy(texts).to(device), []
        for part in torch.split(torch.from_numpy(images), _MOMENTS_AT_ONCE):
            found.append(self.network.similarities(part.to(device).view(-1, *self._cells), goals))
        return torch.cat(found).cpu().numpy()

    @torch.inference_mode()
    def locate(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> PhraseLocations:
        """Returns where phrases are in images of any camera, uint8 (N, H, W, 3).

        They need not be phrases of the fit. Those that goal texts cannot have are not known.
        """
        network, parts = self.network, []
        embeddings = network.embed_phrases(phrases)
        for part in torch.split(torch.tensor(images)[:, None], _MOMENTS_AT_ONCE):  # may be read-only
            parts.append(network.locate(network.embed_cells(part.to(network.device)), embeddings))
        logits, keypoints, presence = (torch.cat(each)[:, 0].cpu() for each in zip(*parts, strict=True))
        cells = logits[..., :-1].softmax(dim=2).reshape(*presence.shape, *self._cells[1:3])  # (N, P, h, w)
        heatmaps = cells / cells.amax(dim=(2, 3), keepdim=True)
        x, y = keypoints.double().unbind(dim=2)
        heat = heat_of_presence(presence.double().numpy())
        known = np.array([self.network.grammar.phrase(each) is not None for each in phrases], np.float32)
        return PhraseLocations(heatmaps.numpy(), x.numpy(), y.numpy(), heat, known)

    @torch.inference_mode()
    def in_distribution(
        self, distances: npt.NDArray[np.float32], similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Returns how much each answer is like held-out ones, float32 (N,); see `freerein_reward.core.RewardModel`."""
        scores = self.network.temperature(torch.from_numpy(similarities).to(self.network.device))
        distance = torch.from_numpy(distances).to(self.network.device)
        found = self.network.in_distribution(distance, scores.softmax(dim=1).amax(dim=1))
        return np.asarray(found.cpu().numpy(), np.float32)
