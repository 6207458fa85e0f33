"""Skill policies that pick and place, for recipes: behavioural cloning of labelled segments (section 2.4)."""

from freerein_imitation.methods.skills.method import METHOD as METHOD
