"""Image encoders, by the name that a configuration chooses: frames uint8 (N, H, W, C) to features float32 (N, D).

A new encoder is a module here and a line in `ENCODERS`.
"""

from collections.abc import Mapping
from types import MappingProxyType

from freerein.learning.encoders.cameras import CameraEncoders, FrameTensors
from freerein.learning.encoders.convolutional import ConvolutionalEncoder
from freerein.learning.encoders.encoder import EncoderClass
from freerein.learning.encoders.moments import MomentsEncoder
from freerein.learning.encoders.patch import PatchEncoder
from freerein.learning.encoders.principal import PrincipalEncoder
from freerein.learning.encoders.spatial import SpatialEncoder

__all__ = [
    "ENCODERS",
    "CameraEncoders",
    "ConvolutionalEncoder",
    "FrameTensors",
    "MomentsEncoder",
    "PatchEncoder",
    "PrincipalEncoder",
    "SpatialEncoder",
]

ENCODERS: Mapping[str, EncoderClass] = MappingProxyType(
    {
        "patch": PatchEncoder,
        "spatial": SpatialEncoder,
        "moments": MomentsEncoder,
        "principal": PrincipalEncoder,
        "convolutional": ConvolutionalEncoder,
    }
)
"""All but `convolutional` subtract a mean image: for cameras that do not move."""
