"""The networks of OpenAI's CLIP RN50 (Radford et al., 2021), with the names of its published weights.

Written from the paper and the layout of the weights. All sizes follow from the shapes of the weights, so that wider and
deeper ones (RN101, RN50x4) are read, too.
"""

from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

_EXPANSION = 4
_HEAD_CHANNELS = 64


@dataclass(frozen=True)
class ClipShape:
    """Sizes of a CLIP model with a ResNet.

    Attributes:
        dimension: D, of the embeddings.
        width: Channels of the stem's output.
        depths: Bottlenecks of each of four stages.
        cells: Height and width of the last maps: a 32nd of the image's.
        text_width: Channels of the text encoder.
        text_depth: Its layers.
        text_length: Longest text, in tokens.
        tokens: Different tokens.
    """

    dimension: int
    width: int
    depths: tuple[int, int, int, int]
    cells: int
    text_width: int
    text_depth: int
    text_length: int
    tokens: int

    @property
    def channels(self) -> int:
        """Channels of the last maps."""
        return 32 * self.width


class Clip(nn.Module):
    """Image and text encoder."""

    def __init__(self, shape: ClipShape) -> None:
        super().__init__()
        self.visual = ModifiedResNet(shape)
        self.transformer = _Transformer(shape)
        self.token_embedding = nn.Embedding(shape.tokens, shape.text_width)
        self.positional_embedding = nn.Parameter(torch.empty(shape.text_length, shape.text_width))
        self.ln_final = nn.LayerNorm(shape.text_width)
        self.text_projection = nn.Parameter(torch.empty(shape.text_width, shape.dimension))
        self.logit_scale = nn.Parameter(torch.empty(()))

    def embed_texts(self, ids: Tensor) -> Tensor:
        """Returns the embeddings, (K, D), of tokens int64 (K, L), read at the end token, the highest number."""
        x = self.token_embedding(ids) + self.positional_embedding[: ids.shape[1]]  # (K, L, C)
        x = self.transformer(x)
        ends = x[torch.arange(len(ids), device=ids.device), ids.argmax(dim=1)]
        embeddings: Tensor = self.ln_final(ends) @ self.text_projection
        return embeddings


class ModifiedResNet(nn.Module):
    """A ResNet with a stem of three convolutions, average pooling before strides, and attention pooling."""

    def __init__(self, shape: ClipShape) -> None:
        super().__init__()
        half = shape.width // 2
        self.conv1, self.bn1 = nn.Conv2d(3, half, 3, stride=2, padding=1, bias=False), nn.BatchNorm2d(half)
        self.conv2, self.bn2 = nn.Conv2d(half, half, 3, padding=1, bias=False), nn.BatchNorm2d(half)
        self.conv3, self.bn3 = nn.Conv2d(half, shape.width, 3, padding=1, bias=False), nn.BatchNorm2d(shape.width)
        first, second, third, fourth = shape.depths
        self.layer1 = _stage(shape.width, shape.width, first, stride=1)
        self.layer2 = _stage(4 * shape.width, 2 * shape.width, second, stride=2)
        self.layer3 = _stage(8 * shape.width, 4 * shape.width, third, stride=2)
        self.layer4 = _stage(16 * shape.width, 8 * shape.width, fourth, stride=2)
        self.attnpool = AttentionPool2d(shape)

    def feature_maps(self, pixels: Tensor) -> Tensor:
        """Returns the last maps, (N, C, h, w), of normalised pixels (N, 3, 32 h, 32 w)."""
        x = pixels
        for convolution, norm in ((self.conv1, self.bn1), (self.conv2, self.bn2), (self.conv3, self.bn3)):
            x = functional.relu(norm(convolution(x)))
        x = functional.avg_pool2d(x, 2)
        maps: Tensor = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        return maps


class AttentionPool2d(nn.Module):
    """Multi-head attention whose query is the mean of all cells; each cell has a position embedding."""

    def __init__(self, shape: ClipShape) -> None:
        super().__init__()
        channels = shape.channels
        self._heads = channels // _HEAD_CHANNELS
        self.positional_embedding = nn.Parameter(torch.empty(1 + shape.cells**2, channels))
        self.k_proj, self.q_proj, self.v_proj = (nn.Linear(channels, channels) for _ in range(3))
        self.c_proj = nn.Linear(channels, shape.dimension)

    def forward(self, maps: Tensor, *, fixed_attention: bool = False) -> Tensor:
        """Returns the embeddings, (N, D), of maps (N, C, h, w).

        With `fixed_attention` their gradient takes the attention weights for constants.
        """
        cells = maps.flatten(start_dim=2).transpose(1, 2)  # (N, S, C)
        cells = torch.cat([cells.mean(dim=1, keepdim=True), cells], dim=1) + self.positional_embedding
        query, key, value = (
            projected.unflatten(2, (self._heads, _HEAD_CHANNELS)).transpose(1, 2)  # (N, heads, 1 or 1 + S, C')
            for projected in (self.q_proj(cells[:, :1]), self.k_proj(cells), self.v_proj(cells))
        )
        weights = (query * _HEAD_CHANNELS**-0.5 @ key.transpose(2, 3)).softmax(dim=3)
        attended = (weights.detach() if fixed_attention else weights) @ value  # (N, heads, 1, C')
        embeddings: Tensor = self.c_proj(attended.flatten(start_dim=1))
        return embeddings


class _Bottleneck(nn.Module):
    def __init__(self, channels: int, planes: int, *, stride: int) -> None:
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(channels, planes, 1, bias=False), nn.BatchNorm2d(planes)
        self.conv2, self.bn2 = nn.Conv2d(planes, planes, 3, padding=1, bias=False), nn.BatchNorm2d(planes)
        self.conv3 = nn.Conv2d(planes, _EXPANSION * planes, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(_EXPANSION * planes)
        self.avgpool = nn.AvgPool2d(stride) if stride > 1 else nn.Identity()
        layers: OrderedDict[str, nn.Module] = OrderedDict()
        if stride > 1 or channels != _EXPANSION * planes:
            layers["-1"] = nn.AvgPool2d(stride)
            layers["0"] = nn.Conv2d(channels, _EXPANSION * planes, 1, bias=False)
            layers["1"] = nn.BatchNorm2d(_EXPANSION * planes)
        self.downsample = nn.Sequential(layers)  # empty for none

    def forward(self, x: Tensor) -> Tensor:
        """Returns (N, 4 planes, h / stride, w / stride) of x (N, channels, h, w)."""
        y = functional.relu(self.bn1(self.conv1(x)))
        y = self.avgpool(functional.relu(self.bn2(self.conv2(y))))
        return functional.relu(self.bn3(self.conv3(y)) + self.downsample(x))


class _Transformer(nn.Module):
    def __init__(self, shape: ClipShape) -> None:
        super().__init__()
        self.resblocks = nn.ModuleList(_ResidualAttention(shape.text_width) for _ in range(shape.text_depth))

    def forward(self, x: Tensor) -> Tensor:
        """Returns (K, L, C) of x (K, L, C)."""
        for layer in self.resblocks:
            x = layer(x)
        return x


class _ResidualAttention(nn.Module):
    """A layer of the text encoder: causal attention, then an MLP."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(width, width // _HEAD_CHANNELS, batch_first=True)
        self.ln_1 = nn.LayerNorm(width)
        self.mlp = nn.Sequential(
            OrderedDict(c_fc=nn.Linear(width, 4 * width), gelu=_QuickGelu(), c_proj=nn.Linear(4 * width, width))
        )
        self.ln_2 = nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """Returns (K, L, C) of x (K, L, C)."""
        seen = self.ln_1(x)
        is_later = torch.ones(2 * (x.shape[1],), dtype=torch.bool, device=x.device).triu(1)
        x = x + self.attn(seen, seen, seen, attn_mask=is_later, need_weights=False)[0]
        outputs: Tensor = x + self.mlp(self.ln_2(x))
        return outputs


class _QuickGelu(nn.Module):
    """The approximation of GELU that the model was trained with."""

    def forward(self, x: Tensor) -> Tensor:
        """Returns x times the logistic function of 1.702 x."""
        return x * torch.sigmoid(1.702 * x)


def _stage(channels: int, planes: int, depth: int, *, stride: int) -> nn.Sequential:
    first = _Bottleneck(channels, planes, stride=stride)
    return nn.Sequential(first, *(_Bottleneck(_EXPANSION * planes, planes, stride=1) for _ in range(depth - 1)))
