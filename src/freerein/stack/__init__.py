"""Services as child processes of this machine, and where running services are found."""

from freerein.stack.endpoints import Endpoints as Endpoints
from freerein.stack.endpoints import choose as choose
from freerein.stack.endpoints import configured_ports as configured_ports
from freerein.stack.endpoints import free_ports as free_ports
from freerein.stack.endpoints import isolated_environ as isolated_environ
from freerein.stack.process import RestartPolicy as RestartPolicy
from freerein.stack.process import ServiceStatus as ServiceStatus
from freerein.stack.stack import Stack as Stack
