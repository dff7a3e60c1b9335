"""Data as a page carries it: compressed, in base64, for the browser to unpack when it is looked at."""

import base64
import gzip
import json
from typing import Any


def packed(content: bytes) -> str:
    """Bytes as text; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(content, compresslevel=9, mtime=0)).decode()


def packed_json(content: Any) -> str:  # noqa: ANN401  whatever JSON holds
    """Plain data as text; NaN and infinity, which JSON has not, are refused."""
    return packed(json.dumps(content, separators=(",", ":"), allow_nan=False).encode())
