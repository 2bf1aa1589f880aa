import socket
import threading

from uniforce_robots.sensors.http_capture import HttpCapture


def test_a_login_in_the_address_is_sent_and_never_part_of_the_path() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        heard: list[bytes] = []

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                heard.append(connection.recv(4096))

        thread = threading.Thread(target=serve)
        thread.start()
        HttpCapture(f"http://anna:s3%20cret@127.0.0.1:{server.getsockname()[1]}/video").release()
        thread.join()
    assert heard[0].startswith(b"GET /video HTTP/1.0\r\n")
    assert b"Authorization: Basic YW5uYTpzMyBjcmV0\r\n" in heard[0]  # anna:s3 cret
