"""The colours of the demo's pictures."""

INK, PAPER, FAINT = "#1f2430", "#ffffff", "#8b93a3"
GOOD, BAD = "#2f9e58", "#d63a3a"
