"""Training of the grounding model, on synthetic images of single objects. Cards name its data by this path."""
