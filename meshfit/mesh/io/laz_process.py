"""Decode a LAZ file from standard input to integers on standard output; the process that a damaged file may kill."""

import io
import sys

import laspy
import numpy as np

_FREE_BYTES = 2**31
_BYTES_PER_BYTE = 200


def main() -> None:
    """Write (N, 3) 32-bit integers, then (N, M) float64 of the extra bytes that the M arguments name.

    An argument is `:NAME`, or `COLUMN:NAME` for a column of extra bytes that have several.
    """
    content = sys.stdin.buffer.read()
    try:
        import resource
    except ImportError:  # a system without limits
        pass
    else:
        limit = _FREE_BYTES + _BYTES_PER_BYTE * len(content)
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    cloud = laspy.read(io.BytesIO(content), laz_backend=laspy.LazBackend.Lazrs)
    sys.stdout.buffer.write(np.stack([cloud.X, cloud.Y, cloud.Z], axis=1).astype("<i4").tobytes())
    columns = []
    for argument in sys.argv[1:]:
        column, _, name = argument.partition(":")
        values = np.asarray(cloud[name], dtype="<f8")
        columns.append(values[:, int(column)] if column else values)
    if columns:
        sys.stdout.buffer.write(np.stack(columns, axis=1).tobytes())


if __name__ == "__main__":
    main()
