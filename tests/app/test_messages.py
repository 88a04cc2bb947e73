"""What goes to a page for a move: the drawing before the measures, and all that changes together as one message."""

from __future__ import annotations

import asyncio
import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra `designer` is not installed")

from bokeh.document import Document
from bokeh.models import ColumnDataSource, Div, Range1d
from bokeh.protocol import Protocol

from platform_ctrl.app.backend import Backend
from platform_ctrl.app.pictures import Drawing
from platform_ctrl.app.web import Together


@pytest.mark.parametrize("loop", ["caging 9-10", "stabilisation"])
def test_what_is_drawn_is_the_pictures_and_comes_before_it_is_measured(
    loop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Backend("examples/three_gyro_platform.toml")
    settings = bench.start(loop)
    drawings: list[Drawing] = []
    picture = bench.picture(settings, drawings.append)
    (drawing,) = drawings
    assert type(drawing) is Drawing
    for one in dataclasses.fields(Drawing):
        assert getattr(drawing, one.name) is getattr(picture, one.name)
    assert drawing.crossover == picture.margins.crossover
    assert {r.limit for r in picture.requirements if r.name == "bandwidth"} <= {drawing.bandwidth}

    class Stopped(Exception):
        pass

    def stop(drawing: Drawing) -> None:
        raise Stopped

    def measured(*arguments: object) -> None:
        raise AssertionError("measured before it was drawn")

    monkeypatch.setattr("platform_ctrl.app.caged.measure", measured)
    monkeypatch.setattr("platform_ctrl.app.closed_loops.coupled_check", measured)
    with pytest.raises(Stopped):
        bench.picture(settings, stop)


def test_simultaneous_changes_are_one_message_with_text_first() -> None:
    def page() -> tuple[Document, ColumnDataSource, Range1d, Div]:
        out = Document()
        source = ColumnDataSource(data={"x": np.zeros(0, np.float32)}, name="source")
        models = source, Range1d(name="range"), Div(name="words")
        for model in models:
            out.add_root(model)
        return out, *models

    here, source, view, words = page()
    there = Document.from_json(here.to_json())
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    server: Any = SimpleNamespace(send_message=send, subscribe=lambda connection: None)
    connection = Together(Protocol(), server, server, server)
    waiting: list[Any] = []
    here.on_change(lambda event: waiting.append(connection.send_patch_document(event)))
    numbers = np.array([1.5, np.nan, -3e30], dtype=np.float32)
    source.data = {"x": numbers, "y": np.arange(3.0)}
    view.end = 7.0
    words.text = "new"

    async def all_of_them() -> None:
        for one in waiting:
            await one

    asyncio.run(all_of_them())
    assert len(waiting) == 3
    (message,) = sent
    assert not message.buffers
    assert message.content["events"][0]["model"]["id"] == words.id
    text = [message.header_json, message.metadata_json, message.content_json]
    received = Protocol().assemble(*text)
    received.apply_to_document(there)
    np.testing.assert_array_equal(there.get_model_by_name("source").data["x"], numbers)
    np.testing.assert_array_equal(there.get_model_by_name("source").data["y"], np.arange(3.0))
    assert there.get_model_by_name("range").end == 7.0
    assert there.get_model_by_name("words").text == "new"
