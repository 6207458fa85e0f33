"""Random generators that snapshots can hold: numpy's PCG64, as 37 bytes."""

import struct

import numpy as np

from freerein.errors import must_be

_LAYOUT = struct.Struct("<16s16sBI")  # state, inc, has_uint32, uinteger
PACKED_BYTES = _LAYOUT.size


def generator(seed: np.random.SeedSequence) -> np.random.Generator:
    """Returns a generator of the kind that snapshots can hold."""
    return np.random.Generator(np.random.PCG64(seed))


def jumped(rng: np.random.Generator) -> np.random.Generator:
    """Returns a generator far ahead of `rng` in its stream; `rng` does not advance."""
    return np.random.Generator(_bits(pack(rng)).jumped())


def pack(rng: np.random.Generator) -> bytes:
    """Returns the state of a generator in `PACKED_BYTES` bytes."""
    bits = rng.bit_generator.state
    state, inc = (bits["state"][key].to_bytes(16, "little") for key in ("state", "inc"))
    return _LAYOUT.pack(state, inc, bits["has_uint32"], bits["uinteger"])


def unpack(packed: bytes) -> np.random.Generator:
    """Returns a generator of the state that `pack` returned. Raises InvalidInput for bytes that are none."""
    return np.random.Generator(_bits(packed))


def _bits(packed: bytes) -> np.random.PCG64:
    if len(packed) != PACKED_BYTES or packed[16] % 2 == 0 or packed[32] > 1:  # an even increment may repeat one number
        rule, hint = f"{PACKED_BYTES} bytes that hold a PCG64", "Send the snapshot back unchanged."
        raise must_be("The state of a generator", rule, "others", field="snapshot", hint=hint)
    state, inc, has_uint32, uinteger = _LAYOUT.unpack(packed)
    bits = np.random.PCG64(0)
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": int.from_bytes(state, "little"), "inc": int.from_bytes(inc, "little")},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return bits
