"""The stand-in's actions: the three services and the topic that an action is made of."""

from __future__ import annotations

import inspect
import itertools
import os
from collections.abc import Awaitable, Callable, Generator
from enum import IntEnum

from rclpy.qos import QoSProfile

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
_numbers = itertools.count(1)


class GoalResponse(IntEnum):
    REJECT = 1
    ACCEPT = 2


class CancelResponse(IntEnum):
    REJECT = 1
    ACCEPT = 2


class Turn:
    """Awaited: the executor goes on with other work."""

    def __await__(self) -> Generator[None, None, None]:
        yield


class ServerGoalHandle:
    def __init__(self, request: object, goal_id: object) -> None:
        self.request = request
        self.goal_id = goal_id
        self.is_cancel_requested = False
        self.status = 0
        self.result: object = None

    def succeed(self) -> None:
        self.status = SUCCEEDED

    def abort(self) -> None:
        self.status = ABORTED

    def canceled(self) -> None:
        self.status = CANCELED


class ActionServer:
    def __init__(
        self,
        node: object,
        kind: type,
        name: str,
        execute: Callable[[ServerGoalHandle], Awaitable[object]],
        *,
        callback_group: object,
        goal_callback: Callable[[object], object],
        cancel_callback: Callable[[object], CancelResponse],
    ) -> None:
        self._node = node
        self._execute = execute
        self._goal_callback = goal_callback
        self._cancel_callback = cancel_callback
        self._handles: dict[tuple, ServerGoalHandle] = {}
        answers = {"send_goal": self._asked, "get_result": self._result, "cancel_goal": self._cancel}
        for service, answer in answers.items():
            made = getattr(kind.Impl, service)
            node.create_service(made, f"{name}/_action/{service}", answer, callback_group=callback_group)

    async def _asked(self, request: object, response: object) -> object:
        found = self._goal_callback(request.goal)
        if inspect.isawaitable(found):
            found = await found
        response.accepted = found == GoalResponse.ACCEPT
        if response.accepted:
            handle = self._handles[tuple(request.goal_id.uuid)] = ServerGoalHandle(request.goal, request.goal_id)
            self._node.begun.append(self._run(handle))
        return response

    async def _run(self, handle: ServerGoalHandle) -> None:
        handle.result = await self._execute(handle)

    async def _result(self, request: object, response: object) -> object:
        handle = self._handles[tuple(request.goal_id.uuid)]
        while handle.result is None:
            await Turn()
        response.status, response.result = handle.status, handle.result
        return response

    def _cancel(self, request: object, response: object) -> object:
        handle = self._handles.get(tuple(request.goal_id.uuid))
        if handle and handle.result is None and self._cancel_callback(handle) == CancelResponse.ACCEPT:
            handle.is_cancel_requested = True
            response.goals_canceling = [request.goal_id]
        return response

    def destroy(self) -> None:
        pass


class Later:
    """A future of what is made of another's result."""

    def __init__(self, future: object, made: Callable[[object], object]) -> None:
        self._future = future
        self._made = made

    def done(self) -> bool:
        return self._future.done()

    def result(self) -> object:
        return self._made(self._future.result())


class ClientGoalHandle:
    def __init__(self, client: ActionClient, goal_id: object, accepted: bool) -> None:
        self._client = client
        self._goal_id = goal_id
        self.accepted = accepted

    def cancel_goal_async(self) -> object:
        return self._client.call("cancel_goal", goal_id=self._goal_id)

    def get_result_async(self) -> object:
        return self._client.call("get_result", goal_id=self._goal_id)


class ActionClient:
    def __init__(self, node: object, kind: type, name: str) -> None:
        self._kind = kind
        self._clients = {
            service: node.create_client(getattr(kind.Impl, service), f"{name}/_action/{service}")
            for service in ("send_goal", "get_result", "cancel_goal")
        }
        self._heard: dict[tuple, Callable[[object], None]] = {}
        topic = f"{name}/_action/feedback"
        node.create_subscription(kind.Impl.FeedbackMessage, topic, self._fed_back, QoSProfile(depth=10))

    def _fed_back(self, message: object) -> None:
        if heard := self._heard.get(tuple(message.goal_id.uuid)):
            heard(message)

    def call(self, service: str, **fields: object) -> object:
        return self._clients[service].call_async(getattr(self._kind.Impl, service).Request(**fields))

    def wait_for_server(self, timeout_sec: float) -> bool:
        return self._clients["send_goal"].wait_for_service(timeout_sec=timeout_sec)

    def send_goal_async(self, goal: object, feedback_callback: Callable[[object], None]) -> Later:
        goal_id = self._kind.Impl.send_goal.Request().goal_id
        goal_id.uuid = [*os.getpid().to_bytes(8, "big"), *next(_numbers).to_bytes(8, "big")]
        self._heard[tuple(goal_id.uuid)] = feedback_callback
        sent = self.call("send_goal", goal_id=goal_id, goal=goal)
        return Later(sent, lambda response: ClientGoalHandle(self, goal_id, response.accepted))
