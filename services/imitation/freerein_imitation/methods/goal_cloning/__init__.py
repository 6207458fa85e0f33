"""Goal-conditioned behavioural cloning, for goal images."""

from freerein_imitation.methods.goal_cloning.method import METHOD as METHOD
