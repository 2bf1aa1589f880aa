"""A client of the stand-in arm and hand in plain sockets, so that the wire is tested without a
vendor's wheel."""

import socket
import struct
import time

import numpy as np

from uniforce_robots.standins.fci import protocol as p

TIMEOUT_s = 30.0  # a busy machine is slow, a hung server is for ever


def decode_state(datagram):
    number, body, generator, controller, *flags, mode, rate = p.unpack(
        p.STATE, datagram, "RobotState"
    )
    bits = (frozenset(i for i, flag in enumerate(some) if flag) for some in flags)
    return p.RobotState(
        number, np.frombuffer(body, "<f4").copy(), generator, controller, *bits, mode, rate
    )


def decode_hand_state(datagram):
    state = p.HandState(*p.unpack(p.HAND_STATE, datagram, "HandState"))
    return state._replace(is_grasped=bool(state.is_grasped))


def encode_command(command):
    return p.COMMAND.pack(command.message_id, False, False, *command.tau_J_d, command.finished)


def hand_request(*numbers):
    return np.array(numbers, "<f8").tobytes()


class RawClient:
    """One TCP connection, one UDP socket, answers matched by command id."""

    def __init__(self, address, port, header):
        tcp = socket.create_connection((address, port), TIMEOUT_s)
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        udp.bind((tcp.getsockname()[0], 0))  # states go to the address the TCP connection came from
        udp.settimeout(TIMEOUT_s)
        self.tcp, self.udp, self.header = tcp, udp, header
        self._buffer, self._next_id = b"", 1

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.tcp.close()
        self.udp.close()

    def send(self, command, payload=b""):
        command_id, self._next_id = self._next_id, self._next_id + 1
        self.tcp.sendall(self.header.encode(p.Message(command, command_id, payload)))
        return command_id

    def receive(self):
        while True:
            message, self._buffer = self.header.decode(self._buffer)
            if message is not None:
                return message
            data = self.tcp.recv(65536)
            if not data:
                raise ConnectionError("the server hung up")
            self._buffer += data

    def ask(self, command, payload=b""):
        asked, answer = (command, self.send(command, payload)), self.receive()
        if (answer.command, answer.command_id) != asked:
            raise ConnectionError(f"answer to {asked} was ({answer.command}, {answer.command_id})")
        return answer.payload

    def datagram(self):
        data, self.server = self.udp.recvfrom(65536)
        return data

    def greet(self, version, layout):
        answer = self.ask(p.ArmCommand.CONNECT, p.CONNECT.pack(version, self.udp.getsockname()[1]))
        self.status, _ = p.unpack(struct.Struct(layout), answer, "answer to Connect")


class RawArm(RawClient):
    def __init__(self, address):
        super().__init__(address, p.ARM_PORT, p.ARM_HEADER)
        self.greet(p.ARM_VERSION, "<BH")

    def state(self):
        """Return the next state, in order: older ones may be queued."""
        return decode_state(self.datagram())

    def newest(self):
        """Return the newest state, skipping what is queued."""
        state = self.state()
        self.udp.setblocking(False)
        try:
            while True:
                state = self.state()
        except BlockingIOError:
            return state
        finally:
            self.udp.settimeout(TIMEOUT_s)

    def move(self, generator=p.NO_GENERATOR):
        """Ask for a motion; return the request's id. The first answer is still to be received."""
        # deviations and speeds, which the stand-in does not use, as libfranka's
        limits = *(10.0, 3.12, 2 * np.pi) * 2, False, *[2.0] * 7
        return self.send(p.ArmCommand.MOVE, p.MOVE.pack(p.EXTERNAL, generator, *limits))

    def start(self):
        """Begin a torque motion, which the arm has to accept; return the request's id."""
        command_id, answer = self.move(), self.receive()
        started = bytes([p.MoveStatus.MOTION_STARTED])
        assert (answer.command_id, answer.payload) == (command_id, started)
        return command_id

    def loop(self, law, ticks):
        """Answer so many states with a control law."""
        for _ in range(ticks):
            self.udp.sendto(encode_command(law(self.newest())), self.server)


class RawHand(RawClient):
    def __init__(self, address):
        super().__init__(address, p.HAND_PORT, p.HAND_HEADER)
        self.greet(p.HAND_VERSION, "<HH")

    def status_of(self, command, payload=b""):
        (status,) = p.unpack(struct.Struct("<H"), self.ask(command, payload), "answer of the hand")
        return status


def wait_until(condition, timeout_s=10.0, what="condition"):
    """Poll a condition; return the seconds it took, or raise TimeoutError."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > timeout_s:
            raise TimeoutError(f"{what}: not within {timeout_s} s")
        time.sleep(0.005)
    return time.monotonic() - start
