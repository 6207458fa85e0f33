"""Chapter 3: demonstrations given as images, followed by policies of a robot's own exploration."""
