"""Language policies, for texts: distillation of single-task policies (section 4.3)."""

from freerein_imitation.methods.language.method import METHOD as METHOD
