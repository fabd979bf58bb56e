"""Transport streams of KLV and a small video, written by FFmpeg through PyAV."""

from __future__ import annotations

import pathlib
from fractions import Fraction

import numpy as np
import pytest


def muxed(path: pathlib.Path, *streams: list[bytes], video: bool = True) -> pathlib.Path:
    """A transport stream of KLV pieces, one list for each data stream, with a video of 64 x 48 pixels."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w", format="mpegts") as container:
        images = container.add_stream("mpeg2video", rate=25) if video else None
        if images is not None:
            images.width, images.height, images.pix_fmt = 64, 48, "yuv420p"
        data = [container.add_data_stream("klv") for _ in streams]
        for k in range(max(len(pieces) for pieces in streams)):
            if images is not None:
                frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")
                frame.pts = k
                container.mux(images.encode(frame))
            for stream, pieces in zip(data, streams, strict=True):
                piece = av.Packet(pieces[k])
                piece.stream, piece.time_base, piece.pts, piece.dts = stream, Fraction(1, 25), k, k
                container.mux(piece)
        if images is not None:
            container.mux(images.encode(None))
    return path
