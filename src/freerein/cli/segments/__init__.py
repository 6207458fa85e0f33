"""Segments of a trajectory as a user sees them: in the terminal, as a picture, as the subtitles of a video."""
