"""What browsers see of the orchestrator: the page's files, and the calls of other services that are passed on."""
