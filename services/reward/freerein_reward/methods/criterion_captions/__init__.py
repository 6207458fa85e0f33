"""A dual encoder of the criteria of table 4.1, which finds phrases in each camera by their embeddings (section 4.2)."""

from freerein_reward.methods.criterion_captions.method import METHOD as METHOD
