"""A robot with the real `openpi-client`: `openpi_robot.py ADDRESS TOKEN` prints what it met.

ADDRESS is that of the service around `faulty_policy`. A frame is 4 x 4 pixels, and its brightness tells it from others.
"""

import json
import sys

import msgpack
import msgpack_numpy
import numpy as np
import openpi_client.msgpack_numpy
import websockets.sync.client
from openpi_client import action_chunk_broker, base_policy, websocket_client_policy
from openpi_client.runtime import environment, runtime, subscriber
from openpi_client.runtime.agents import policy_agent

HORIZON = 3
GOAL = 6


def frame(brightness):
    """Returns a frame, uint8 (4, 4, 3)."""
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, 0, 2] = brightness
    return pixels


class Robot(environment.Environment):
    """Gets brighter with every action, until it has reached the goal."""

    def __init__(self):
        self.actions = []
        self.reset()

    def reset(self):
        """Begins an episode."""
        self._steps = 0
        self._is_over = False

    def is_episode_complete(self):
        """Returns whether the policy says that the goal is reached."""
        return self._is_over

    def get_observation(self):
        """Returns the frame and the goal; and, at first, that an episode begins."""
        seen = {"observation/front": frame(self._steps), "goal/front": frame(GOAL)}
        return {**seen, "reset": True} if self._steps == 0 else seen

    def apply_action(self, action):
        """Executes one action."""
        self.actions.append(np.asarray(action["actions"]).tolist())
        self._is_over = action["done"] == "yes"
        self._steps += 1


class Recorder(base_policy.BasePolicy):
    """A policy that writes down which observations were sent."""

    def __init__(self, policy):
        self._policy = policy
        self.replies = []

    def infer(self, obs):
        """Returns the policy's reply."""
        reply = self._policy.infer(obs)
        self.replies.append({"brightness": int(obs["observation/front"][0, 0, 2]), **listed(reply)})
        return reply

    def reset(self):
        """Resets the policy, which openpi's client does not tell the server."""
        self._policy.reset()


class Steps(subscriber.Subscriber):
    """Counts the steps of each episode."""

    def __init__(self):
        self.counts = []

    def on_episode_start(self):
        """Begins to count."""
        self.counts.append(0)

    def on_step(self, _observation, _action):
        """Counts."""
        self.counts[-1] += 1

    def on_episode_end(self):
        """Does nothing."""


def listed(reply):
    """Returns a reply for JSON."""
    assert reply["actions"].dtype == np.float32
    return {**reply, "actions": reply["actions"].tolist()}


def run_episodes(address):
    """Returns what two episodes of the runtime met, with chunks executed whole."""
    policy = Recorder(websocket_client_policy.WebsocketClientPolicy(*address))
    robot, steps = Robot(), Steps()
    broker = action_chunk_broker.ActionChunkBroker(policy, HORIZON)
    runtime.Runtime(robot, policy_agent.PolicyAgent(broker), [steps], num_episodes=2).run()
    return {"replies": policy.replies, "executed": robot.actions, "steps": steps.counts}


def refused(action):
    """Returns the error that an action raises."""
    try:
        action()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"


def try_errors(address):
    """Returns the errors that the client shows, and what comes after one."""
    client = websocket_client_policy.WebsocketClientPolicy
    policy = client(*address)
    goal = {"goal/front": frame(GOAL)}
    errors = {
        "key": refused(lambda: policy.infer({"image": frame(0), **goal})),
        "shape": refused(lambda: policy.infer({"observation/front": np.zeros((3, 4, 4), np.uint8), **goal})),
        "goal": refused(lambda: policy.infer({"observation/front": frame(0)})),
        "model": refused(lambda: client(f"ws://{address[0]}:{address[1]}/?model.name=unknown", api_key=address[2])),
        "token": refused(lambda: client(address[0], address[1], api_key="wrong")),
    }
    return {**errors, "after": listed(policy.infer({"observation/front": frame(0), **goal}))}


def speak_like_others(address):
    """Returns what those meet who send what DROID's or LIBERO's examples send, a prompt, or msgpack-numpy's arrays."""
    policy = websocket_client_policy.WebsocketClientPolicy(*address)
    seen, pixels = {"observation/front": frame(0), "goal/front": frame(GOAL)}, np.zeros((224, 224, 3), np.uint8)
    droid = {
        "observation/exterior_image_1_left": pixels,
        "observation/wrist_image_left": pixels,
        "observation/joint_position": np.zeros(7, np.float32),
        "observation/gripper_position": np.zeros(1, np.float32),
        "prompt": "pick up the cup",
    }
    libero = {
        "observation/image": pixels,
        "observation/wrist_image": pixels,
        "observation/state": np.zeros(8, np.float32),
        "prompt": "pick up the cup",
    }
    met = {
        "droid": refused(lambda: policy.infer(droid)),
        "libero": refused(lambda: policy.infer(libero)),
        "prompt": policy.infer({**seen, "prompt": "pick up the cup"})["note"],
    }
    with websockets.sync.client.connect(
        f"ws://{address[0]}:{address[1]}/", additional_headers={"Authorization": f"Bearer {address[2]}"}
    ) as connection:
        connection.recv()
        connection.send(msgpack.packb(seen, default=msgpack_numpy.encode))
        return {**met, "msgpack-numpy": listed(openpi_client.msgpack_numpy.unpackb(connection.recv()))}


def main():
    """Prints everything as JSON."""
    host, port = sys.argv[1].split(":")
    address = (host, int(port), sys.argv[2])
    metadata = websocket_client_policy.WebsocketClientPolicy(*address).get_server_metadata()
    sys.stdout.write(
        json.dumps(
            {
                "metadata": metadata,
                "episodes": run_episodes(address),
                "errors": try_errors(address),
                "others": speak_like_others(address),
            }
        )
    )


main()
