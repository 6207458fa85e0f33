"""The orchestrator for browsers: the page's files, and the calls of other services that are passed on."""
