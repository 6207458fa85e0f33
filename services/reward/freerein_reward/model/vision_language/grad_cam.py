"""Grad-CAM (Selvaraju et al., 2017) of any vision-language model: where an image shows what texts name.

The heat of a cell is the product of its channels and of weights, above 0; a channel's weight is the spatial mean of
the gradient of the similarity. With attention and length held fixed, a model that pools its cells by attention has
weights in closed form, the same in all images: what its value and output projections take the channel for, in the
text's direction. They are value maps (Zhou et al., "Extract free dense labels from CLIP", 2022) less their biases,
which cells share.
"""

import torch
from torch import Tensor

from freerein_reward.model.vision_language.interface import VisionLanguageModel


def heat_maps(model: VisionLanguageModel, images: Tensor, directions: Tensor) -> Tensor:
    """Returns the heat of each direction, float32 (N, P, h, w), in images uint8 (N, H, W, 3).

    `directions`, (P, D), are embeddings of texts, or differences of them. Heat is in units of the model's maps: only
    that of one model can be compared.
    """
    weights = model.channel_weights(directions)
    if weights is None:
        maps, weights_of_images = gradient_weights(model, images, directions)
        return torch.einsum("npc,nchw->nphw", weights_of_images, maps).relu()
    return torch.einsum("pc,nchw->nphw", weights, model.last_maps(images)).relu()


def gradient_weights(model: VisionLanguageModel, images: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the last maps, (N, C, h, w), and Grad-CAM's channel weights by a backward pass, float32 (N, P, C)."""
    with torch.inference_mode(mode=False), torch.enable_grad():
        maps, embeddings = model.traced_maps(images.clone())  # of inference mode, it could not be traced
        similarities = (embeddings @ directions.clone().T).sum(dim=0)  # (P,)
        last = len(similarities) - 1
        gradients = [torch.autograd.grad(each, maps, retain_graph=at < last) for at, each in enumerate(similarities)]
    weights = torch.stack([gradient.mean(dim=(2, 3)) for (gradient,) in gradients], dim=1)
    return maps.detach(), weights
