"""How policies learn: to reach goal images, to execute skills, and to do what a sentence says."""
