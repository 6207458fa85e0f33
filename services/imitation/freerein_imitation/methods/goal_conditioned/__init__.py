"""The goal-conditioned skill policy of chapter 3, for goal images."""

from freerein_imitation.methods.goal_conditioned.method import METHOD as METHOD
