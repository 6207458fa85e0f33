"""`freerein doctor`: checks this machine and the services."""

from freerein.cli.doctor.command import doctor as doctor
