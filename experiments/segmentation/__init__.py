"""Chapter 2: skill segmentation from trajectory-level tags, beside full supervision and guessing."""
