"""The stand-in's node, with its publishers, subscriptions, services, clients, timers and parameters."""

from __future__ import annotations

import itertools
import json
import pickle
import sys
import time
from collections import deque
from collections.abc import Iterator
from types import SimpleNamespace

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters

from rclpy import types
from rclpy.exceptions import InvalidParameterTypeException, ParameterAlreadyDeclaredException
from rclpy.handles import Events, Handle, NodeHandle, SubscriptionHandle
from rclpy.parameter import Parameter, value_of
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.wire import SERVICE_S

_numbers = itertools.count(1)
NAMED_S = 0.2
"""The graph knows a publisher or subscription so much sooner than the name of its node."""
UNKNOWN = {"node_name": "_NODE_NAME_UNKNOWN_", "node_namespace": "_NODE_NAMESPACE_UNKNOWN_"}


class Arguments:
    """What --ros-args says."""

    def __init__(self, words: list[str]) -> None:
        self.remaps: dict[str, str] = {}
        self.parameters: dict[str, object] = {}
        words = words[words.index("--ros-args") + 1 :] if "--ros-args" in words else []
        for option, text in itertools.pairwise(words):
            name, sign, value = text.partition(":=")
            if option in ("-r", "--remap") and sign:
                self.remaps[name] = value
            elif option in ("-p", "--param") and sign:
                self.parameters[name] = _parsed(value)


def _parsed(text: str) -> object:
    if text.startswith("["):
        return [_parsed(part.strip()) for part in text[1:-1].split(",")]
    try:
        return json.loads(text)
    except ValueError:
        return text.strip("'\"")


class Publisher:
    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile) -> None:
        self._node = node
        self._lasting = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._last: bytes | None = None
        self.topic_name = topic
        self.row = {**node.end(topic, kind._name, qos), "number": next(_numbers)}
        self._sent = 0
        self._unacknowledged: set[tuple[str, int]] = set()
        """Subscriptions that have not acknowledged the last message: the process and the number of each."""
        self._acks = next(_numbers)
        node.wire.handlers[self._acks] = self._acknowledged
        node.wire.publishers.append(self.row)
        node.wire.handlers[self.row["number"]] = self._joined
        node.wire.tell()

    def publish(self, message: object) -> None:
        data = self._last = pickle.dumps(types.to_plain(message))
        self._sent += 1
        packet = (data, time.time_ns(), (self._node.wire.name, self._acks, self._sent))
        matched = list(self._matched())
        self._unacknowledged = {(name, row["number"]) for name, row in matched if row["reliable"]}
        for name, row in matched:
            self._node.wire.send(name, (row["number"], packet))

    def _matched(self) -> Iterator[tuple[str, dict]]:
        for name, ends in self._node.wire.graph().items():
            yield from ((name, row) for row in ends["subscriptions"] if _match(self.row, row))

    def _acknowledged(self, packet: tuple) -> None:
        if packet[0] == self._sent:
            self._unacknowledged.discard(packet[1])

    def wait_for_all_acked(self, timeout: object) -> bool:
        """What is asked at once, the only way here. One that has left need not acknowledge."""
        assert timeout.nanoseconds == 0
        self._unacknowledged &= {(name, row["number"]) for name, row in self._matched()}
        return not self._unacknowledged

    def _joined(self, packet: tuple) -> None:
        """A subscription that has come later asks for the last message."""
        if self._lasting and self._last is not None:
            self._node.wire.send(packet[0], (packet[1], (self._last, time.time_ns(), None)))

    def get_subscription_count(self) -> int:
        return len(list(self._matched()))


def _match(publisher: dict, subscription: dict) -> bool:
    same = publisher["topic"] == subscription["topic"] and publisher["type"] == subscription["type"]
    return same and all(publisher[of] or not subscription[of] for of in ("reliable", "lasting"))


class Subscription:
    def __init__(self, node: Node, kind: type, topic: str, callback: object, qos: QoSProfile, raw: bool) -> None:
        self.callback = callback
        self.topic_name = topic
        self.msg_type = kind
        self.raw = raw
        self.waiting: deque = deque(maxlen=qos.depth)
        self.handle = SubscriptionHandle(self)
        self.row = {**node.end(topic, kind._name, qos), "number": next(_numbers)}
        self._wire = node.wire
        node.wire.handlers[self.row["number"]] = self._arrived
        node.wire.subscriptions.append(self.row)
        node.wire.tell()
        if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            for name, ends in node.wire.graph().items():
                for row in ends["publishers"]:
                    if _match(row, self.row):
                        node.wire.send(name, (row["number"], (node.wire.name, self.row["number"])))

    def _arrived(self, packet: tuple) -> None:
        self.waiting.append((*packet, time.time_ns()))
        if (acks := packet[2]) and self.row["reliable"]:
            self._wire.send(acks[0], (acks[1], (acks[2], (self._wire.name, self.row["number"]))))

    def take(self) -> object:
        data = self.waiting.popleft()[0]
        return data if self.raw else types.from_plain(self.msg_type._name, pickle.loads(data))


class Service:
    def __init__(self, node: Node, kind: type, name: str, callback: object) -> None:
        self.kind = kind
        self.callback = callback
        self.waiting: deque = deque()
        self.handle = Handle(self.waiting)
        self._wire = node.wire
        row = {"topic": name, "type": kind._name, "number": next(_numbers), "node": node.full_name}
        node.wire.handlers[row["number"]] = self.waiting.append
        node.wire.services.append(row)
        node.wire.tell()

    def send_response(self, response: object, header: tuple) -> None:
        self._wire.send(header[0], (header[1], (header[2], types.to_plain(response))), SERVICE_S)


class Future:
    def __init__(self) -> None:
        self._result: object = None
        self._done = False

    def done(self) -> bool:
        return self._done

    def set_result(self, result: object) -> None:
        self._result, self._done = result, True

    def result(self) -> object:
        return self._result


class Client:
    def __init__(self, node: Node, kind: type, name: str) -> None:
        self._node = node
        self._kind = kind
        self._name = name
        self._number = next(_numbers)
        self._pending: dict[int, Future] = {}
        node.wire.handlers[self._number] = self._answered

    def _servers(self) -> list[tuple[str, dict]]:
        found = self._node.wire.graph().items()
        return [(name, row) for name, ends in found for row in ends["services"] if row["topic"] == self._name]

    def wait_for_service(self, timeout_sec: float) -> bool:
        until_s = time.monotonic() + timeout_sec
        while not (there := bool(self._servers())) and time.monotonic() < until_s:
            time.sleep(0.01)
        return there

    def call_async(self, request: object) -> Future:
        asked, future = next(_numbers), Future()
        self._pending[asked] = future
        for name, row in self._servers():
            header = (self._node.wire.name, self._number, asked)
            self._node.wire.send(name, (row["number"], (header, types.to_plain(request))), SERVICE_S)
        return future

    def _answered(self, packet: tuple) -> None:
        self._pending.pop(packet[0]).set_result(types.from_plain(f"{self._kind._name}_Response", packet[1]))


class Logger:
    def __init__(self, name: str) -> None:
        self._name = name

    def _write(self, level: str, text: str) -> None:
        sys.stderr.write(f"[{level}] [{time.time():.9f}] [{self._name}]: {text}\n")
        sys.stderr.flush()

    def info(self, text: str) -> None:
        self._write("INFO", text)

    def warning(self, text: str) -> None:
        self._write("WARN", text)

    def error(self, text: str) -> None:
        self._write("ERROR", text)


class Node:
    def __init__(self, name: str, *, arguments: Arguments, wire: object) -> None:
        self.wire = wire
        self._arguments = arguments
        self._name = arguments.remaps.get("__node", name)
        self._namespace = "/" + arguments.remaps.get("__ns", "").strip("/")
        self.full_name = f"{self._namespace.rstrip('/')}/{self._name}"
        self.subscriptions: list[Subscription] = []
        self.services: list[Service] = []
        self.guards: list[object] = []
        self.clients: list[object] = []
        """None: an answer needs no spinning here."""
        self.waitables: list[object] = [Events()]
        self.executor: object = None
        self.handle = NodeHandle(self)
        self.context = SimpleNamespace(handle=SimpleNamespace(wire=wire))
        self.begun: list[object] = []
        """Coroutines that the executor is to go on with."""
        self._parameters: dict[str, Parameter] = {}
        self._free: set[str] = set()
        self._callbacks: list = []
        self.create_service(GetParameters, "~/get_parameters", self._get)
        self.create_service(SetParameters, "~/set_parameters", self._set)

    def end(self, topic: str, kind: str, qos: QoSProfile) -> dict:
        names = {"node_name": self._name, "node_namespace": self._namespace, "s": time.time()}
        reliable = qos.reliability == ReliabilityPolicy.RELIABLE
        lasting = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        row = {"topic": topic, "type": kind, "reliable": reliable, "lasting": lasting, "depth": qos.depth}
        return {**row, **names}

    def _wake_executor(self) -> None:
        if self.executor:
            self.executor.wake()

    def get_name(self) -> str:
        return self._name

    def get_logger(self) -> Logger:
        return Logger(self._name)

    def get_clock(self) -> object:
        # With a simulator's time that nobody publishes, as here, it is 0.
        ns = 0 if self._arguments.parameters.get("use_sim_time") else time.time_ns()
        stamp = types.TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=ns, to_msg=lambda: stamp))

    def _resolved(self, name: str) -> str:
        name = self._arguments.remaps.get(name, name)
        if name.startswith("~"):
            return f"{self.full_name}{name[1:]}"
        return name if name.startswith("/") else f"{self._namespace.rstrip('/')}/{name}"

    def create_publisher(self, kind: type, topic: str, qos: QoSProfile | int) -> Publisher:
        qos = QoSProfile(depth=qos) if isinstance(qos, int) else qos
        return Publisher(self, kind, self._resolved(topic), qos)

    def create_subscription(
        self, kind: type, topic: str, callback: object, qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        self.subscriptions.append(Subscription(self, kind, self._resolved(topic), callback, qos, raw))
        self._wake_executor()
        return self.subscriptions[-1]

    def destroy_subscription(self, subscription: Subscription) -> None:
        self.subscriptions.remove(subscription)
        self._wake_executor()
        self.wire.subscriptions.remove(subscription.row)
        self.wire.tell()

    def destroy_publisher(self, publisher: Publisher) -> None:
        self.wire.publishers.remove(publisher.row)
        self.wire.tell()

    def create_service(self, kind: type, name: str, callback: object, *, callback_group: object = None) -> Service:
        self.services.append(Service(self, kind, self._resolved(name), callback))
        self.services[-1].alone = callback_group is None
        self._wake_executor()
        return self.services[-1]

    def create_client(self, kind: type, name: str) -> Client:
        return Client(self, kind, self._resolved(name))

    def destroy_node(self) -> None:
        pass

    def count_publishers(self, topic: str) -> int:
        return len(self.get_publishers_info_by_topic(topic))

    def count_subscribers(self, topic: str) -> int:
        return len(self.get_subscriptions_info_by_topic(topic))

    def get_publishers_info_by_topic(self, topic: str) -> list[object]:
        return self._infos("publishers", topic)

    def get_subscriptions_info_by_topic(self, topic: str) -> list[object]:
        return self._infos("subscriptions", topic)

    def _infos(self, ends: str, topic: str) -> list[object]:
        found = self.wire.graph().values()
        name = self._resolved(topic)
        return [_info(row) for process in found for row in process[ends] if row["topic"] == name]

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        rows = [row for ends in self.wire.graph().values() for row in ends["publishers"] + ends["subscriptions"]]
        names = sorted({row["topic"] for row in rows})
        return [(name, sorted({row["type"] for row in rows if row["topic"] == name})) for name in names]

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        rows = [row for ends in self.wire.graph().values() for row in ends["services"]]
        return sorted((row["topic"], [row["type"]]) for row in rows)

    def declare_parameter(self, name: str, value: object, descriptor: object = None) -> Parameter:
        if name in self._parameters:
            raise ParameterAlreadyDeclaredException(name)
        given = self._arguments.parameters.get(name, value)
        free = descriptor is not None and descriptor.dynamic_typing
        if not free and Parameter(name, value=given).type_ != Parameter(name, value=value).type_:
            raise InvalidParameterTypeException(name)
        if free:
            self._free.add(name)
        self._parameters[name] = Parameter(name, value=given)
        return self._parameters[name]

    def add_on_set_parameters_callback(self, callback: object) -> None:
        self._callbacks.append(callback)

    def set_parameters(self, parameters: list[Parameter]) -> list[object]:
        results = []
        for parameter in parameters:
            result = SetParametersResult(successful=True)
            if parameter.name not in self._parameters:
                result = SetParametersResult(successful=False, reason=f"{parameter.name} is not declared")
            elif parameter.name not in self._free and parameter.type_ != self._parameters[parameter.name].type_:
                result = SetParametersResult(successful=False, reason="Wrong parameter type")
            for callback in self._callbacks:
                if result.successful:
                    result = callback([parameter])
            if result.successful:
                self._parameters[parameter.name] = parameter
            results.append(result)
        return results

    def _get(self, request: object, response: object) -> object:
        missing = Parameter("", value=None)
        response.values = [self._parameters.get(name, missing).message().value for name in request.names]
        return response

    def _set(self, request: object, response: object) -> object:
        asked = [Parameter(row.name, value=value_of(row.value)) for row in request.parameters]
        response.results = self.set_parameters(asked)
        return response


def _info(row: dict) -> object:
    reliability = ReliabilityPolicy.RELIABLE if row["reliable"] else ReliabilityPolicy.BEST_EFFORT
    durability = DurabilityPolicy.TRANSIENT_LOCAL if row["lasting"] else DurabilityPolicy.VOLATILE
    named = row if time.time() - row["s"] > NAMED_S else UNKNOWN
    return SimpleNamespace(
        node_name=named["node_name"],
        node_namespace=named["node_namespace"],
        topic_type=row["type"],
        qos_profile=QoSProfile(depth=row["depth"], reliability=reliability, durability=durability),
    )
