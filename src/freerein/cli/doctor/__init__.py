"""`freerein doctor`: what is missing on this machine, and how to mend it."""

from freerein.cli.doctor.verb import doctor as doctor
