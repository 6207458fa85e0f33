"""Frozen dataclasses that cores take and return, clients take and return, and `freerein.wire` puts on a wire.

One module per service, and `common` for what several share. Field names equal those of the `.proto` files.
"""
