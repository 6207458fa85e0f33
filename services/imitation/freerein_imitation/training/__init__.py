"""How policies learn: goal-conditioned ones from exploration, without any label."""
