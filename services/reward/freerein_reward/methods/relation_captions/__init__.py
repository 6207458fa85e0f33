"""A dual encoder trained on captions of the grounding model (section 4.2)."""

from freerein_reward.methods.relation_captions.method import METHOD as METHOD
