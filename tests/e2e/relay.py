"""A link that can stand still: a TCP relay between a commander and the gateway."""

import socket
from contextlib import ExitStack, suppress
from threading import Event, Thread
from types import TracebackType
from typing import Self


class Relay:
    """Forwards one connection after the other; what goes to the gateway waits while `flowing` is not set."""

    def __init__(self, port: int) -> None:
        self._target = ("127.0.0.1", port)
        self._sockets = ExitStack()
        self._server = self._sockets.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self.flowing = Event()
        self.flowing.set()
        self._threads = [Thread(target=self._accept)]
        self._threads[0].start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.flowing.set()
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._threads[0].join()
        for thread in self._threads[1:]:
            thread.join()
        self._sockets.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near = self._sockets.enter_context(self._server.accept()[0])
                far = self._sockets.enter_context(socket.create_connection(self._target))
                self._forward(near, far, self.flowing)
                self._forward(far, near, None)

    def _forward(self, source: socket.socket, sink: socket.socket, flowing: Event | None) -> None:
        def run() -> None:
            with suppress(OSError):
                while data := source.recv(65536):
                    if flowing is not None:
                        flowing.wait()
                    sink.sendall(data)
            with suppress(OSError):
                sink.shutdown(socket.SHUT_RDWR)

        thread = Thread(target=run)
        self._threads.append(thread)
        thread.start()
