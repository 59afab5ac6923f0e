"""Point clouds with named columns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, header

FLOAT32, UINT8 = 7, 2  # sensor_msgs/PointField


def cloud_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    columns: list[tuple[str, NDArray[Any]]],
) -> Any:
    """Return a sensor_msgs/PointCloud2 of named columns (N,) or (N, C).

    Columns of uint8 are stored as they are, all others as float32.
    """
    count = len(columns[0][1])
    fields, parts, offset = [], [], 0
    for name, values in columns:
        width = int(np.prod(np.shape(values)[1:]))
        block = np.ascontiguousarray(values).reshape(count, width)
        kind = UINT8 if block.dtype == np.uint8 else FLOAT32
        if kind == FLOAT32:
            block = block.astype('<f4')
        fields.append(
            factory.make(
                'sensor_msgs/PointField',
                name=name,
                offset=offset,
                datatype=kind,
                count=block.shape[1],
            )
        )
        parts.append(block.view(np.uint8).reshape(count, block.itemsize * block.shape[1]))
        offset += block.itemsize * block.shape[1]
    data = np.concatenate(parts, axis=1) if count else np.empty(0, np.uint8)
    return factory.make(
        'sensor_msgs/PointCloud2',
        header=header(factory, stamp, frame),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=False,
        point_step=offset,
        row_step=offset * count,
        data=factory.sequence(data.reshape(-1)),
        is_dense=True,
    )


def cloud_columns(message: Any) -> dict[str, NDArray[Any]]:
    """Return the float32 and uint8 fields of a PointCloud2, each as (N, count)."""
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.frombuffer(message.data, np.uint8)
    if data.size < count * step:
        raise DataError(f'point cloud: {data.size} bytes, expected {count} points of {step} bytes')
    rows = data[: count * step].reshape(count, step)
    order = '>' if message.is_bigendian else '<'
    columns: dict[str, NDArray[Any]] = {}
    for item in message.fields:
        dtype = {FLOAT32: np.dtype(order + 'f4'), UINT8: np.dtype('u1')}.get(int(item.datatype))
        if dtype is None:
            continue
        size = dtype.itemsize * int(item.count)
        block = np.ascontiguousarray(rows[:, item.offset : item.offset + size])
        if block.shape[1] != size:
            raise DataError(f'point cloud: field {item.name!r} exceeds the point step')
        columns[item.name] = block.view(dtype).reshape(count, int(item.count))
    return columns
