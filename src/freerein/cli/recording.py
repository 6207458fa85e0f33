"""Records the sim service's demonstrations into a dataset, and goes on where an earlier recording stopped."""

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from pathlib import Path

from freerein.cli.streams import reconnecting
from freerein.clients import SimClient
from freerein.clients.dataset_recorder import DatasetRecorder
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksRequest


async def record(client: SimClient, request: DemonstrateRequest, root: Path, *, on_count: Callable[[int], None]) -> int:
    """Makes a dataset hold the `request.count` demonstrations of a request. Those it holds already stay.

    Args:
        client: The sim service.
        request: What to demonstrate; `first` is ours to choose.
        root: Where the dataset lies, or will lie.
        on_count: Called with the number of trajectories on disk, at first and after each one.

    Returns:
        How many trajectories the dataset holds.

    Raises:
        FailedPrecondition: The dataset holds something else.
        ServiceError: The service refused, or went away for good.
    """
    with DatasetRecorder(root, request, await client.list_tasks(ListTasksRequest())) as recording:
        on_count(len(recording))
        if not recording.is_complete:
            async with aclosing(reconnecting(lambda: _rest(client, recording))) as demonstrations:
                async for demonstration in demonstrations:
                    recording.append(demonstration)
                    on_count(len(recording))
        return len(recording)


async def _rest(client: SimClient, recording: DatasetRecorder) -> AsyncGenerator[DemonstrateResponse, None]:
    """Yields the demonstrations that a dataset does not hold yet."""
    async with aclosing(client.demonstrate(recording.remaining)) as demonstrations:
        async for demonstration in demonstrations:
            yield demonstration
    recording.check_complete()
