"""Services as child processes of this machine, and where running services are found."""

from freerein.cli.services.endpoints import Endpoints as Endpoints
from freerein.cli.services.endpoints import choose as choose
from freerein.cli.services.endpoints import configured_ports as configured_ports
from freerein.cli.services.endpoints import free_ports as free_ports
from freerein.cli.services.endpoints import isolated_environ as isolated_environ
from freerein.cli.services.process import RestartPolicy as RestartPolicy
from freerein.cli.services.process import ServiceStatus as ServiceStatus
from freerein.cli.services.stack import Stack as Stack
