"""CLIP's ModifiedResNet, made small: a stem of three convolutions, strides that average first, pooling by attention.

It departs from CLIP in two ways. There are two stages, and the last map keeps a quarter of the image's resolution: what
is to be found is a tenth of the image wide. And what is attended to can be asked where it is instead of what it is: a
relation lies between places. As in CLIP, channels are normalised by what is usual in training: statistics of the image
itself would make a thing fainter beside others than alone.
"""

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

_EXPANSION = 4
_HEAD_CHANNELS = 16
SHRINKAGE = 4
"""How many pixels wide a cell of the last map is."""


class ImageTower(nn.Module):
    """Embeds images.

    Args:
        width: Channels of the stem; the last map has 8 times as many.
        depth: Bottlenecks per stage.
        heads: How many things the pooling asks the places of; 0 for CLIP's pooling, which asks what is seen.
        hidden: Units of each of the two layers after a pooling of places.
        features: How many numbers an embedding has.
    """

    def __init__(self, *, width: int, depth: int, heads: int, hidden: int, features: int) -> None:
        super().__init__()
        self.stem = _stem(width)
        self.near = _stage(2 * width, width, depth, stride=2)
        self.far = _stage(_EXPANSION * width, 2 * width, depth, stride=1)
        channels = 2 * _EXPANSION * width
        self.pool: AttentionPool | PlacePool = (
            PlacePool(channels=channels, heads=heads, hidden=hidden, features=features)
            if heads
            else AttentionPool(channels=channels, features=features)
        )

    def forward(self, images: Tensor) -> Tensor:
        """Returns the embeddings (N, D), not yet of length 1, of images uint8 (N, H, W, 3)."""
        embeddings: Tensor = self.pool(self.maps(images))
        return embeddings

    def maps(self, images: Tensor) -> Tensor:
        """Returns the last convolution's output after its ReLU, (N, C, H / 4, W / 4), of images uint8 (N, H, W, 3)."""
        pixels = images.permute(0, 3, 1, 2).float().sub_(127.5).div_(64.0)  # (N, 3, H, W), channels last in memory
        maps: Tensor = self.far(self.near(self.stem(pixels)))
        return maps

    @property
    def attention(self) -> "AttentionPool":
        """The pooling of a tower that asks what is seen.

        Raises:
            TypeError: It asks for places.
        """
        if not isinstance(self.pool, AttentionPool):
            raise TypeError("This image tower asks for places: it cannot be asked what a cell shows.")
        return self.pool

    @property
    def places(self) -> "PlacePool":
        """The pooling of a tower that asks for places.

        Raises:
            TypeError: It asks what is seen.
        """
        if not isinstance(self.pool, PlacePool):
            raise TypeError("This image tower asks what is seen: it cannot be asked for places.")
        return self.pool


class AttentionPool(nn.Module):
    """One round of multi-head attention, in which the mean of all cells asks each cell and itself (CLIP's).

    There is one question per image, so that keys and values are never computed cell by cell: q . (K x) is (K^T q) . x,
    and the weighted sum of V x is V times the weighted sum of x. Values have no bias: what no cell says is not said.
    Cells do not know where they are.

    Args:
        channels: Of a map.
        features: How many numbers come out.
    """

    def __init__(self, *, channels: int, features: int) -> None:
        super().__init__()
        self._heads = (channels // _HEAD_CHANNELS, _HEAD_CHANNELS)
        self.query = nn.Linear(channels, channels)
        self.key = nn.Linear(channels, channels, bias=False)  # softmax would not see a bias
        self.value = nn.Linear(channels, channels, bias=False)
        self.out = nn.Linear(channels, features, bias=False)

    def forward(self, maps: Tensor) -> Tensor:
        """Returns the features (N, D) of maps (N, C, h, w)."""
        cells = maps.flatten(start_dim=2)  # (N, C, S)
        cells = torch.cat([cells.mean(dim=2, keepdim=True), cells], dim=2)  # (N, C, 1 + S)
        query = self.query(cells[:, :, 0]).view(-1, *self._heads) * _HEAD_CHANNELS**-0.5  # (N, heads, C')
        asked = torch.einsum("nhk,hkc->nhc", query, self.key.weight.view(*self._heads, -1))  # (N, heads, C)
        seen = (asked @ cells).softmax(dim=2) @ cells.transpose(1, 2)  # (N, heads, C)
        values = torch.einsum("nhc,hkc->nhk", seen, self.value.weight.view(*self._heads, -1))  # (N, heads, C')
        features: Tensor = self.out(values.flatten(start_dim=1))  # (N, D)
        return features

    def cells(self, maps: Tensor) -> Tensor:
        """Returns what each cell of maps (N, C, h, w) would say, were it all that is attended to: (N, S, D)."""
        said: Tensor = self.out(self.value(maps.flatten(start_dim=2).transpose(1, 2)))
        return said


class PlacePool(nn.Module):
    """Attention whose values are places: each head looks for one thing and says where it is, or that it is nowhere.

    A head's softmax runs over all cells and one more, which is nowhere and scores 0 whatever is shown.

    Args:
        channels: Of a map.
        heads: How many things are looked for.
        hidden: Units of each of two layers, because how things lie to one another is no linear function of places.
        features: How many numbers come out.
    """

    def __init__(self, *, channels: int, heads: int, hidden: int, features: int) -> None:
        super().__init__()
        self.ask = nn.Linear(channels, heads)
        self.relate = nn.Sequential(
            nn.Linear(3 * heads, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, features)
        )

    def forward(self, maps: Tensor) -> Tensor:
        """Returns the features (N, D) of maps (N, C, h, w)."""
        features: Tensor = self.relate(self.find(maps).flatten(start_dim=1))
        return features

    def find(self, maps: Tensor) -> Tensor:
        """Returns row and column in [-1, 1] and mass in [0, 1] of what each head finds: (N, heads, 3).

        Row and column are times the mass, so that nothing is at the middle.
        """
        scores = self.ask(maps.flatten(start_dim=2).transpose(1, 2)).transpose(1, 2)  # (N, heads, S)
        share = functional.pad(scores, (0, 1)).softmax(dim=2)[:, :, :-1]
        rows, columns = ((torch.arange(cells, device=maps.device) + 0.5) / cells * 2 - 1 for cells in maps.shape[2:])
        return share @ functional.pad(torch.cartesian_prod(rows, columns), (0, 1), value=1.0)


class Bottleneck(nn.Module):
    """CLIP's residual block: where it strides, both ways average the pixels that they merge.

    Args:
        channels: That come in.
        planes: Of the inner convolution; four times as many come out.
        stride: 1 or 2.
    """

    def __init__(self, channels: int, planes: int, *, stride: int) -> None:
        super().__init__()
        outcome = planes * _EXPANSION
        self.inner = nn.Sequential(
            *_convolution(channels, planes, kernel=1),
            nn.ReLU(inplace=True),
            *_convolution(planes, planes, kernel=3),
            nn.ReLU(inplace=True),
            *_averaging(stride),
            *_convolution(planes, outcome, kernel=1),
        )
        same = stride == 1 and channels == outcome
        self.skip = nn.Sequential(*(() if same else (*_averaging(stride), *_convolution(channels, outcome, kernel=1))))

    def forward(self, x: Tensor) -> Tensor:
        """Returns (N, 4 planes, h / stride, w / stride) of x (N, channels, h, w)."""
        return functional.relu(self.inner(x) + self.skip(x), inplace=True)


def _stem(width: int) -> nn.Sequential:
    layers: OrderedDict[str, nn.Module] = OrderedDict()
    for place, (before, after, stride) in enumerate(((3, width, 2), (width, width, 1), (width, 2 * width, 1)), start=1):
        layers[f"conv{place}"], layers[f"norm{place}"] = _convolution(before, after, kernel=3, stride=stride)
        layers[f"relu{place}"] = nn.ReLU(inplace=True)
    return nn.Sequential(layers)


def _stage(channels: int, planes: int, depth: int, *, stride: int) -> nn.Sequential:
    first = Bottleneck(channels, planes, stride=stride)
    return nn.Sequential(first, *(Bottleneck(_EXPANSION * planes, planes, stride=1) for _ in range(depth - 1)))


def _convolution(before: int, after: int, *, kernel: int, stride: int = 1) -> tuple[nn.Module, nn.Module]:
    convolution = nn.Conv2d(before, after, kernel, stride=stride, padding=kernel // 2, bias=False)
    return convolution, nn.BatchNorm2d(after)


def _averaging(stride: int) -> tuple[nn.Module, ...]:
    return (nn.AvgPool2d(stride),) if stride > 1 else ()
