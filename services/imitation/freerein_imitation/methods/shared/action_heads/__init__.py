"""Action heads by name: how a policy's hidden features become an action, and how that is learned.

| head | actions | without a draw it executes |
|---|---|---|
| `categorical` | one of some choices | the likeliest |
| `bins` | numbers, each by itself | their means; of a pick point the likeliest bins |
| `autoregressive` | pick and place: location, then direction, then length | the likeliest two, and the mean length |
| `map` | the same; the location is read from feature maps of observation and goal | the same |
"""

from collections.abc import Mapping
from types import MappingProxyType

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec
from freerein_imitation.methods.shared.action_heads.action_head import ActionHead, MakeHead
from freerein_imitation.methods.shared.action_heads.autoregressive import AutoregressiveHead
from freerein_imitation.methods.shared.action_heads.independent import BinsHead, CategoricalHead
from freerein_imitation.methods.shared.action_heads.location_map import MapHead
from freerein_imitation.methods.shared.action_heads.pick_and_place import picks_and_places

__all__ = ["AUTO", "HEADS", "ActionHead", "head_of"]

AUTO = "auto"
"""In place of a name: the first head that fits the actions."""

HEADS: Mapping[str, MakeHead] = MappingProxyType(
    {"categorical": CategoricalHead, "bins": BinsHead, "autoregressive": AutoregressiveHead, "map": MapHead}
)


def head_of(name: str, action: ActionSpec) -> MakeHead:
    """Returns the class of a head for an action space; `auto` is `categorical` or `bins`.

    Raises:
        InvalidInput: The head is of another action space.
    """
    fitting = ["categorical"] if action.choices else ["bins"]
    if picks_and_places(action):
        fitting += ["autoregressive", "map"]
    if name not in (AUTO, *fitting):
        raise InvalidInput(
            f"`head` must be {' or '.join(fitting)} for these actions, {', '.join(action.names)}; got {name}.",
            field="config.head",
            hint="Leave it out for the first.",
        )
    return HEADS[fitting[0] if name == AUTO else name]
