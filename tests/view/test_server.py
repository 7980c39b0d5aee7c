"""The server of a page: what it serves, to whom, and the news."""

import json
import socket
import threading
import urllib.error
import urllib.request

import pytest

from regrasp.errors import InputError
from regrasp.view.server import Server, local


def get(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read()


def test_it_serves_the_page_and_its_story_and_nothing_else():
    with Server(b"story", port=0) as server:
        assert b"<!doctype html>" in get(server.url)
        assert get(server.url + "story") == b"story"
        server.story(b"another")
        assert get(server.url + "story") == b"another"
        for path in ("../cli.py", "web/page.js", "story/"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                get(server.url + path)


def test_it_listens_on_this_machine_only_unless_told_otherwise():
    with Server(b"", port=0) as server:
        assert server.url.startswith("http://127.0.0.1:")
    assert local("127.0.0.1")
    assert local("::1")
    assert not local("0.0.0.0")


def test_who_comes_late_hears_the_latest_of_each_kind():
    with Server(b"", port=0) as server:
        server.news("search", {"done": 1})
        server.news("certificate", {"certificate": None})
        server.news("search", {"done": 2})
        seen, fresh = server.since(0)
        assert [json.loads(text) for text in fresh] == [
            {"kind": "certificate", "certificate": None},
            {"kind": "search", "done": 2},
        ]
        threading.Timer(0.05, server.news, ("search", {"done": 3})).start()
        _, fresh = server.since(seen)
        assert [json.loads(text)["done"] for text in fresh] == [3]
        with urllib.request.urlopen(server.url + "news", timeout=10) as stream:
            assert stream.headers["Content-Type"] == "text/event-stream"
            assert stream.readline().startswith(b"data: ")


def test_a_port_that_is_taken_is_an_error_if_it_was_asked_for():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=str(port)):
            Server(b"", port=port)
    with pytest.raises(InputError, match="port"):
        Server(b"", port=70000)
