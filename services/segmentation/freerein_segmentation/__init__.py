"""The segmentation service of freerein."""
