"""Skill policies of any robot and scene, for recipes: behavioural cloning of labelled segments (section 2.4)."""

from freerein_imitation.methods.skill_cloning.method import METHOD as METHOD
