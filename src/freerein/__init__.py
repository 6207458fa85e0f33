"""freerein serves learned robot skills: segmentation, imitation, reward, simulation and the runs that join them."""

__version__ = "0.1.0"
