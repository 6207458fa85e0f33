"""`OpenpiService`: a policy of openpi's protocol, over the same core as `Act` and `Control`.

openpi's client sends observations and gets actions, one for one. It knows no goals and never says what the robot
executed, nor that an episode begins, so observations may tell (see `observations`), and the connection keeps the rest:
the model's version, the goal and the policy state.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, cast, get_args

import numpy as np
import numpy.typing as npt

from freerein import wire
from freerein.errors import FailedPrecondition, InvalidInput, must_be
from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import Resize
from freerein.unknown_names import described
from freerein_imitation.core.act import Policies
from freerein_imitation.core.act_context import ActContext, spec_response
from freerein_imitation.core.inputs import elapsed_steps
from freerein_imitation.core.policy_session import PolicyBatcher, PolicySession
from freerein_imitation.model.policy import Policy
from freerein_imitation.openpi.messages import pack, read
from freerein_imitation.openpi.observations import OpenpiObservation, parse_observation

MAX_STEPS = 2**32 - 1
_TEXTS = ("model.name", "model.version", "goal.text", "resize")
_NUMBERS = ("max_steps_per_goal", "action_horizon")
_RECIPE = "goal.recipe"


@dataclass(frozen=True)
class OpenpiQuery:
    """The options in the URL of a connection.

    Attributes:
        model: The model; the connection keeps its version.
        goal: The goal; None where observations hold it.
        max_steps_per_goal: As in `ActRequest`.
        action_horizon: Actions of each reply that the robot executes, unless it tells otherwise; 0 for all.
        resize: As in `ActRequest`.
    """

    model: ModelRef
    goal: Goal | None
    max_steps_per_goal: int
    action_horizon: int
    resize: Resize | None = None


@dataclass(frozen=True, eq=False)
class OpenpiService:
    """Opens connections.

    Attributes:
        models: The policies.
        batcher: Runs `PolicyRunner.run_batch` on the model's thread.
    """

    models: Policies
    batcher: PolicyBatcher

    async def open(self, query: Sequence[tuple[str, str]]) -> "OpenpiConnection":
        """Returns a connection as the query of its URL asks for.

        Raises:
            InvalidInput: A parameter is unknown, repeated or invalid.
            NotFound: There is no such model.
            FailedPrecondition: No model is active.
        """
        asked = parse_query(query)
        model, policy = await self.models.resolve(asked.model)
        connection = OpenpiConnection(model, policy, asked, self.batcher)
        if asked.goal is not None:
            await connection.pursue(asked.goal)
        return connection


class OpenpiConnection:
    """One robot's connection: holds the goal and the policy state.

    Attributes:
        greeting: The message sent on connect: the model's spec.
    """

    def __init__(self, model: ModelRef, policy: Policy, query: OpenpiQuery, batcher: PolicyBatcher) -> None:
        self.greeting = pack(wire.to_json(spec_response(model, policy.spec)))
        self._model = model
        self._policy = policy
        self._query = query
        self._batcher = batcher
        self._goal: object = None
        self._context: ActContext | None = None
        self._session: PolicySession | None = None
        self._proposed: npt.NDArray[Any] | None = None
        self._last_action: npt.NDArray[Any] | None = None

    async def answer(self, data: bytes) -> bytes:
        """Returns the reply to a message.

        Raises:
            MalformedRequest: The message is not msgpack.
            InvalidInput: Observation, goal or executed actions do not match the model.
            FailedPrecondition: A hold was asked for before the first executed action arrived.
            ServiceError: The model failed, is overloaded, or did not answer in time.
        """
        arrived_ns = time.perf_counter_ns()
        resizes = self._query.resize is not None
        message = parse_observation(self._policy.spec, await read(data), resizes=resizes)
        if message.reset:
            self._proposed = self._last_action = None
        session = await self._session_of(message)
        executed = self._proposed if message.executed_actions is None else message.executed_actions
        if self._proposed is not None:
            self._proposed = self._proposed[-1:]  # they count once, though there may be no answer
        parsed = await session.parse(message.observation, executed, elapsed=elapsed_steps(executed))
        done = await self._batcher.submit(parsed, key=self._model)
        reply = session.answer(done, arrived_ns=arrived_ns)
        self._proposed = reply["actions"][: self._query.action_horizon or None]
        if executed is not None and len(executed):
            self._last_action = executed[-1]
        if not len(reply["actions"]):
            reply["actions"] = self._hold()
        if not resizes:
            del reply["resized"]
        note = {"note": message.note} if message.note else {}
        return pack({**reply, "model": asdict(self._model), "timing": asdict(reply["timing"]), **note})

    async def pursue(self, goal: Goal) -> None:
        """Starts towards a goal, unless it is the current one.

        Raises:
            InvalidInput: The goal does not match the policy.
        """
        content = (goal.text, goal.recipe, [(image.camera, image.data) for image in goal.images])
        if content != self._goal:
            limit = self._query.max_steps_per_goal
            self._context = await ActContext.create(
                self._model, self._policy, goal, max_steps=limit, resize=self._query.resize
            )
            self._goal, self._session = content, None

    async def _session_of(self, message: OpenpiObservation) -> PolicySession:
        """Returns the session that an observation belongs to: a new one for another goal, or after a reset."""
        if message.goal is not None:
            if self._query.goal is not None:
                raise InvalidInput(
                    "The goal must be given once; the connection's URL has one, and so has the observation.",
                    field="goal",
                    hint="Leave it out of one of them.",
                )
            await self.pursue(message.goal)
        if self._context is None:
            raise InvalidInput(
                "The first observation must hold the goal; got none, and none in the URL.",
                field="goal",
                hint="Send `prompt`, `recipe` or `goal/<camera>`, or put `goal.text` or `goal.recipe` into the URL.",
            )
        if self._session is None or message.reset:
            self._session = PolicySession(self._context)
        return self._session

    def _hold(self) -> npt.NDArray[Any]:
        """Returns actions for a robot whose goals are over, (K, A): openpi's clients cannot execute none."""
        spec = self._policy.spec
        held = self._last_action if spec.action.absolute else spec.action.hold_action()
        if held is None:
            raise FailedPrecondition(
                "A robot whose actions are targets must have executed one, to hold there; it has executed none.",
                field="executed_actions",
                hint="Send the last target as `executed_actions`, or another goal: this one is over.",
            )
        return np.repeat(np.asarray(held, spec.action.dtype)[None], spec.horizon, axis=0)


def parse_query(items: Sequence[tuple[str, str]]) -> OpenpiQuery:
    """Returns the query of a connection's URL, named as the fields of `ActRequest`.

    Raises:
        InvalidInput: A parameter is unknown, repeated or invalid.
    """
    single = {key: value for key, value in items if key != _RECIPE}
    known = (*_TEXTS, *_NUMBERS)
    recipe = tuple(value for key, value in items if key == _RECIPE)
    others = [key for key in single if key not in known]
    if others or len(single) + len(recipe) != len(items):
        got = described(others[0], (*known, _RECIPE)) if others else "one twice."
        raise InvalidInput(
            f"The URL may have {', '.join(known)}, each once, and {_RECIPE}; got {got}",
            hint="Write it like ws://localhost:8102/?model.name=skills&goal.recipe=move-red",
        )
    name, version, text, resize = (single.get(key, "") for key in _TEXTS)
    if resize not in ("", *get_args(Resize)):
        hint = "Leave it out to have images of other sizes refused."
        raise must_be("resize", " or ".join(get_args(Resize)), "another word", hint=hint)
    steps, horizon = (_number(key, single.get(key, "0")) for key in _NUMBERS)
    has_goal = recipe or "goal.text" in single
    goal = Goal(recipe=recipe, text=text) if has_goal else None
    return OpenpiQuery(ModelRef(name, version), goal, steps, horizon, cast(Resize, resize) if resize else None)


def _number(key: str, value: str) -> int:
    if not (value.isascii() and value.isdecimal() and len(value) <= 10 and int(value) <= MAX_STEPS):
        hint = "Leave it out for the model's own."
        raise must_be(key, f"a whole number up to {MAX_STEPS}", f"{len(value)} characters that are not", hint=hint)
    return int(value)
