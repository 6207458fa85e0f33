"""A small version of CLIP's ModifiedResNet: a stem of three convolutions, anti-aliased strides, attention pooling.

Two departures from CLIP: there are two stages, so that the feature map keeps a quarter of the image's resolution
(objects are a tenth of the image wide); and pooling can return the relations of named objects instead of appearance.
Batch normalisation as in CLIP: normalising by each image's own statistics would make an object's features depend on
what else is shown.
"""

from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded

_EXPANSION = 4
_HEAD_CHANNELS = 16
_HALF_MASS = 0.5
"""Sum of a phrase's squared heat at which its presence is 1/2."""

_PEAK_RADIUS = 1
"""Cells around the most probable one whose mean is the keypoint: an object's own, where another is like it."""


@dataclass(frozen=True)
class ClipImageSpec:
    """Sizes of an image encoder.

    Attributes:
        phrases: Noun phrases whose relations are embedded; 0 for attention pooling.
        width: Channels of the stem; a multiple of 8.
        depth: Bottlenecks per stage.
        hidden_size: Units of each of the two hidden layers of the relation pooling.
        embedding_dim: Dimension of the embedding; with phrases, of each pair's.
        at_peaks: Whether phrases are located at the peaks of their heat, by `PeakPool`, and no relations are embedded.
    """

    phrases: int = bounded(0, least=0, most=64)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    hidden_size: int = bounded(64, least=1, most=4096)
    embedding_dim: int = bounded(64, least=4, most=1024)
    at_peaks: bool = False


class ClipFeatureMaps(nn.Module):
    """The convolutions. The feature map has `channels`, and a quarter of the image's resolution."""

    def __init__(self, width: int, depth: int) -> None:
        super().__init__()
        self.channels = 2 * _EXPANSION * width
        self.stem = _stem(width)
        self.layer1 = _stage(2 * width, width, depth, stride=2)
        self.layer2 = _stage(_EXPANSION * width, 2 * width, depth, stride=1)

    def feature_maps(self, images: Tensor) -> Tensor:
        """Returns the feature maps before pooling, (N, C, H / 4, W / 4), of images uint8 (N, H, W, 3)."""
        pixels = images.permute(0, 3, 1, 2).float().sub_(127.5).div_(64.0)  # (N, 3, H, W), channels last in memory
        maps: Tensor = self.layer2(self.layer1(self.stem(pixels)))
        return maps


class ClipImageEncoder(ClipFeatureMaps):
    """Embeds images."""

    def __init__(self, spec: ClipImageSpec) -> None:
        super().__init__(spec.width, spec.depth)
        self.pool = _pool(spec, self.channels)

    def forward(self, images: Tensor) -> Tensor:
        """Returns the pooled embeddings (N, D) of images uint8 (N, H, W, 3)."""
        embeddings: Tensor = self.pool(self.feature_maps(images))
        return embeddings

    def keypoints(self, images: Tensor) -> Tensor:
        """Returns keypoints of phrases in images uint8 (N, H, W, 3), float32 (N, P, 3); see `RelationPool.keypoints`.

        Raises TypeError with attention pooling.
        """
        if isinstance(self.pool, AttentionPool):
            raise TypeError("This image encoder pools by attention; expected phrases.")
        return self.pool.keypoints(self.feature_maps(images))

    @property
    def attention_pool(self) -> "AttentionPool":
        """The attention pooling; a TypeError with relation pooling."""
        if not isinstance(self.pool, AttentionPool):
            raise TypeError("This image encoder pools relations; expected attention pooling.")
        return self.pool

    @property
    def relation_pool(self) -> "RelationPool":
        """The relation pooling; a TypeError with attention pooling."""
        if not isinstance(self.pool, RelationPool):
            raise TypeError("This image encoder pools by attention; expected relation pooling.")
        return self.pool


class AttentionPool(nn.Module):
    """CLIP's attention pooling: multi-head attention whose query is the mean of all cells; no position embedding.

    With one query per image, keys and values need not be computed per cell: q . (K x) is (K^T q) . x, and the weighted
    sum of V x is V times the weighted sum of x.
    """

    def __init__(self, channels: int, *, embedding_dim: int) -> None:
        super().__init__()
        self._heads = (channels // _HEAD_CHANNELS, _HEAD_CHANNELS)
        self.query = nn.Linear(channels, channels)
        self.key = nn.Linear(channels, channels, bias=False)  # softmax is invariant to a bias
        self.value = nn.Linear(channels, channels, bias=False)
        self.out = nn.Linear(channels, embedding_dim, bias=False)

    def forward(self, maps: Tensor, *, fixed_attention: bool = False) -> Tensor:
        """Returns the embeddings (N, D) of feature maps (N, C, h, w).

        With `fixed_attention` their gradient takes the attention weights for constants.
        """
        cells = maps.flatten(start_dim=2)  # (N, C, S)
        cells = torch.cat([cells.mean(dim=2, keepdim=True), cells], dim=2)  # (N, C, 1 + S)
        query = self.query(cells[:, :, 0]).view(-1, *self._heads) * _HEAD_CHANNELS**-0.5  # (N, heads, C')
        scores = torch.einsum("nhk,hkc->nhc", query, self.key.weight.view(*self._heads, -1))  # (N, heads, C)
        weights = (scores @ cells).softmax(dim=2)  # (N, heads, 1 + S)
        attended = (weights.detach() if fixed_attention else weights) @ cells.transpose(1, 2)  # (N, heads, C)
        values = torch.einsum("nhc,hkc->nhk", attended, self.value.weight.view(*self._heads, -1))  # (N, heads, C')
        embeddings: Tensor = self.out(values.flatten(start_dim=1))  # (N, D)
        return embeddings

    def cell_embeddings(self, maps: Tensor) -> Tensor:
        """Returns the embedding that each cell of maps (N, C, h, w) would have with all attention on it: (N, S, D)."""
        embeddings: Tensor = self.out(self.value(maps.flatten(start_dim=2).transpose(1, 2)))
        return embeddings


class RelationPool(nn.Module):
    """A keypoint for every phrase, then one vector for every ordered pair of phrases, by an MLP that all pairs share.

    A keypoint is the centroid of a phrase's squared heat, with a presence that saturates where there is much of it: it
    resolves fractions of a cell, where a softmax over the cells mostly chooses one. The MLP has two hidden layers,
    because relations are not linear in positions. Whoever stands in a relation, it looks the same: what is learned of
    one pair holds for all, however many objects are shown.
    """

    def __init__(self, channels: int, phrases: int, *, hidden_size: int, embedding_dim: int) -> None:
        super().__init__()
        self._pairs = (phrases, embedding_dim)
        self.heat = nn.Linear(channels, phrases)
        layers = (nn.Linear(6, hidden_size), nn.ReLU(), nn.Linear(hidden_size, hidden_size), nn.ReLU())
        self.mlp = nn.Sequential(*layers, nn.Linear(hidden_size, embedding_dim))

    def forward(self, maps: Tensor) -> Tensor:
        """Returns the embeddings (N, P * P * D) of feature maps (N, C, h, w): a unit vector for each ordered pair.

        A phrase and itself are no pair: their vector is 0.
        """
        phrases, _ = self._pairs
        keypoints = self.keypoints(maps)  # (N, P, 3)
        first = keypoints[:, :, None].expand(-1, -1, phrases, -1)
        second = keypoints[:, None].expand(-1, phrases, -1, -1)
        vectors = functional.normalize(self.mlp(torch.cat([first, second], dim=3)), dim=3)  # (N, P, P, D)
        is_pair = ~torch.eye(phrases, dtype=torch.bool, device=maps.device)
        return (vectors * is_pair[:, :, None]).flatten(start_dim=1)

    def keypoints(self, maps: Tensor) -> Tensor:
        """Returns row and column in [-1, 1], both times the presence, and presence in [0, 1]: (N, P, 3)."""
        heat = self.heat(maps.flatten(start_dim=2).transpose(1, 2)).transpose(1, 2).relu().square()  # (N, P, S)
        share = heat / (heat.sum(dim=2, keepdim=True) + _HALF_MASS)
        rows, columns = ((torch.arange(cells, device=maps.device) + 0.5) / cells * 2 - 1 for cells in maps.shape[2:])
        keypoints: Tensor = share @ functional.pad(torch.cartesian_prod(rows, columns), (0, 1), value=1.0)
        return keypoints


class PeakPool(nn.Module):
    """A keypoint for every phrase: the mean position near the peak of its heat.

    The probability of the cells, and that the phrase is nowhere, is a softmax.
    """

    def __init__(self, channels: int, phrases: int) -> None:
        super().__init__()
        self.heat = nn.Linear(channels, phrases)  # above that of being nowhere

    def keypoints(self, maps: Tensor) -> Tensor:
        """Returns keypoints (N, P, 3) of feature maps (N, C, h, w), as `RelationPool` does."""
        heat = self.heat(maps.flatten(start_dim=2).transpose(1, 2)).transpose(1, 2)  # (N, P, S)
        probability = functional.pad(heat, (0, 1)).softmax(dim=2)[..., :-1].reshape(*heat.shape[:2], *maps.shape[2:])
        presence = probability.sum(dim=(2, 3))[..., None]
        return torch.cat([(2 * peak_centroids(probability).flip(2) - 1) * presence, presence], dim=2)


def peak_centroids(probability: Tensor) -> Tensor:
    """Returns the mean position near the most probable cell, (N, P, 2), of probabilities of cells, (N, P, h, w).

    Positions are x and y as fractions of width and height.
    """
    height, width = probability.shape[2:]
    smooth = functional.avg_pool2d(probability, 3, stride=1, padding=1)
    at = smooth.flatten(start_dim=2).argmax(dim=2)  # (N, P)
    rows, columns = torch.arange(height, device=at.device), torch.arange(width, device=at.device)
    near_rows = (rows - (at // width)[..., None]).abs() <= _PEAK_RADIUS  # (N, P, h)
    near_columns = (columns - (at % width)[..., None]).abs() <= _PEAK_RADIUS  # (N, P, w)
    near = (probability + 1e-9) * (near_rows[..., :, None] & near_columns[..., None, :])
    share = near / near.sum(dim=(2, 3), keepdim=True)
    x = (share.sum(dim=2) * ((columns + 0.5) / width)).sum(dim=2)
    y = (share.sum(dim=3) * ((rows + 0.5) / height)).sum(dim=2)
    return torch.stack([x, y], dim=2)


class Bottleneck(nn.Module):
    """CLIP's residual block, with average pooling instead of strides; the output has 4 * planes channels."""

    def __init__(self, channels: int, planes: int, *, stride: int) -> None:
        super().__init__()
        outputs = planes * _EXPANSION
        self.residual = nn.Sequential(
            *_conv_norm(channels, planes, kernel=1),
            nn.ReLU(inplace=True),
            *_conv_norm(planes, planes, kernel=3),
            nn.ReLU(inplace=True),
            *_average_pool(stride),
            *_conv_norm(planes, outputs, kernel=1),
        )
        is_identity = stride == 1 and channels == outputs
        layers = () if is_identity else (*_average_pool(stride), *_conv_norm(channels, outputs, kernel=1))
        self.shortcut = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        """Returns (N, 4 planes, h / stride, w / stride) of x (N, channels, h, w)."""
        return functional.relu(self.residual(x) + self.shortcut(x), inplace=True)


def _pool(spec: ClipImageSpec, channels: int) -> AttentionPool | RelationPool | PeakPool:
    if not spec.phrases:
        return AttentionPool(channels, embedding_dim=spec.embedding_dim)
    if spec.at_peaks:
        return PeakPool(channels, spec.phrases)
    return RelationPool(channels, spec.phrases, hidden_size=spec.hidden_size, embedding_dim=spec.embedding_dim)


def _stem(width: int) -> nn.Sequential:
    layers: OrderedDict[str, nn.Module] = OrderedDict()
    for place, (before, after, stride) in enumerate(((3, width, 2), (width, width, 1), (width, 2 * width, 1)), start=1):
        layers[f"conv{place}"], layers[f"norm{place}"] = _conv_norm(before, after, kernel=3, stride=stride)
        layers[f"relu{place}"] = nn.ReLU(inplace=True)
    return nn.Sequential(layers)


def _stage(channels: int, planes: int, depth: int, *, stride: int) -> nn.Sequential:
    first = Bottleneck(channels, planes, stride=stride)
    return nn.Sequential(first, *(Bottleneck(_EXPANSION * planes, planes, stride=1) for _ in range(depth - 1)))


def _conv_norm(before: int, after: int, *, kernel: int, stride: int = 1) -> tuple[nn.Module, nn.Module]:
    convolution = nn.Conv2d(before, after, kernel, stride=stride, padding=kernel // 2, bias=False)
    return convolution, nn.BatchNorm2d(after)


def _average_pool(stride: int) -> tuple[nn.Module, ...]:
    return (nn.AvgPool2d(stride),) if stride > 1 else ()
