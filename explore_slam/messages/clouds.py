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


# numpy's types of sensor_msgs/PointField's datatypes, without byte order
_DTYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}


def cloud_field(message: Any, name: str) -> NDArray[Any] | None:
    """Return a field of a PointCloud2 for every point (height * width,), None if there is none.

    Whatever its type and place: other fields, padding of points and rows and the order of bytes
    do not matter. Of a field of several numbers, the first. DataError for a layout that the data
    do not hold.
    """
    field = next((item for item in message.fields if item.name == name), None)
    if field is None:
        return None
    code = _DTYPES.get(int(field.datatype))
    if code is None:
        raise DataError(
            f'point cloud: field {name!r} has the datatype {field.datatype}, '
            f'expected one of {list(_DTYPES)}'
        )
    dtype = np.dtype(code).newbyteorder('>' if message.is_bigendian else '<')
    rows, columns = int(message.height), int(message.width)
    if rows == 0 or columns == 0:
        return np.empty(0, dtype)
    step, row_step, offset = int(message.point_step), int(message.row_step), int(field.offset)
    if row_step == 0 and rows == 1:  # left out by drivers of clouds in one row
        row_step = step * columns
    data = np.frombuffer(message.data, np.uint8)
    end = (rows - 1) * row_step + (columns - 1) * step + offset + dtype.itemsize
    if offset + dtype.itemsize > step or step * columns > row_step or end > data.size:
        raise DataError(
            f'point cloud: {data.size} bytes, point_step {step}, row_step {row_step} and field '
            f'{name!r} at {offset} do not hold {rows} x {columns} points'
        )
    view: NDArray[Any] = np.ndarray((rows, columns), dtype, data.data, offset, (row_step, step))
    return view.reshape(-1)


def cloud_points(message: Any) -> NDArray[np.float64]:
    """Return x, y, z (N, 3) m of all points of a PointCloud2, those that are NaN included."""
    columns = []
    for name in 'xyz':
        values = cloud_field(message, name)
        if values is None or values.dtype.kind != 'f':
            fields = [(item.name, int(item.datatype)) for item in message.fields]
            raise DataError(
                f'point cloud: fields and datatypes are {fields}, expected x, y and z of 7 '
                '(float32) or 8 (float64)'
            )
        columns.append(values.astype(np.float64))
    return np.stack(columns, axis=1)


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
