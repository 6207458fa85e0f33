"""Goals: a relation between two blocks that the first is moved into."""

from dataclasses import dataclass

from freerein_sim.worlds.blocks.relations import BlockRelation

GOAL_RELATIONS = (BlockRelation.LEFT_OF, BlockRelation.RIGHT_OF, BlockRelation.ON_TOP_OF)


@dataclass(frozen=True)
class BlockGoal:
    """The block of colour `first`, which is moved, in a relation to the block of colour `second`."""

    first: str
    relation: BlockRelation
    second: str

    @property
    def name(self) -> str:
        """The goal as part of a task name."""
        return f"{self.first}-{self.relation.value}-{self.second}"

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"a {self.first} block {self.relation.text} a {self.second} block"
