"""Chapter 4: its tasks, the teachers that ship, one policy from many, and rewards to compare with."""
