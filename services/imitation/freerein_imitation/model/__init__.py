"""Policy networks, and the policies that serve them: numpy in, numpy out."""
