"""Finds the tasks of all installed packages.

A package registers worlds by an entry point in the group `freerein.worlds` that resolves to a tuple of
`TaskDefinition`:

    [project.entry-points."freerein.worlds"]
    grid = "freerein_sim.worlds.grid:TASKS"
"""

from importlib.metadata import entry_points

from freerein.errors import AlreadyExists
from freerein_sim.worlds.world import TaskDefinition

ENTRY_POINT_GROUP = "freerein.worlds"


def tasks() -> dict[str, TaskDefinition]:
    """Returns every installed task by name, sorted; does not import simulators.

    Raises:
        AlreadyExists: Two packages register a task of the same name.
    """
    found: dict[str, TaskDefinition] = {}
    for entry_point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda each: each.name):
        for task in entry_point.load():
            if task.name in found:
                raise AlreadyExists(
                    f"Expected every task to have a name of its own; {task.name} is offered twice.",
                    hint=f"Uninstall one of the packages whose entry points in {ENTRY_POINT_GROUP} offer it.",
                )
            found[task.name] = task
    return dict(sorted(found.items()))
