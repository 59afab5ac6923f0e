"""Files of rosbag2's sqlite3 storage, with a write-ahead log or with damaged pages."""

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from explore_slam.errors import RecordingError
from explore_slam.recording.storage.storage import RawMessage, Storage, UnusableTopic

MAGIC = b'SQLite format 3\x00'
_LOGS = ('-wal', '-journal')  # of transactions that have not reached the database itself
_LONGEST_GAP = 20_000  # rows that are looked for one by one where no index tells the last one


class SqliteFile(Storage):
    """Reads one database, row by row where its pages are damaged."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._topics: dict[int, str] = {}
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._rows: list[tuple[int, int, int]] | None = None
        try:
            self._database = self._connect()
            self._survey()
        except sqlite3.Error as error:
            self.close()
            raise RecordingError(f'{path} cannot be read as a database: {error}') from error

    def close(self) -> None:
        """Close the database."""
        if hasattr(self, '_database'):
            self._database.close()
        if self._scratch is not None:
            self._scratch.cleanup()

    def _connect(self) -> sqlite3.Connection:
        """Open for reading only; where a log must be rolled back first, open a copy.

        Without locks and in exclusive mode, sqlite keeps the index of a write-ahead log in memory
        instead of a file, so that the recording is left as it is.
        """
        logs = [log for end in _LOGS if (log := _beside(self.path, end)).exists()]
        if not any(log.stat().st_size for log in logs):
            if (whole := _stated_size(self.path)) > self.path.stat().st_size:
                return self._padded(whole)
            return _opened(f'file:{quote(str(self.path))}?mode=ro&immutable=1')
        found = _opened(f'file:{quote(str(self.path))}?mode=ro&vfs=unix-none')
        try:
            found.execute('PRAGMA locking_mode = EXCLUSIVE')
            found.execute('SELECT count(*) FROM sqlite_master').fetchone()
        except sqlite3.Error:
            found.close()
            return _opened(f'file:{quote(str(self._copy(logs)))}')
        return found

    def _padded(self, size: int) -> sqlite3.Connection:
        """Open a copy of a truncated file, as long as it was: sqlite refuses a shorter one."""
        self.damage('is truncated at byte {}', self.path.stat().st_size)
        copy = self._copy(())
        try:
            os.truncate(copy, size)  # without data, it takes no space
        except (OSError, OverflowError) as error:
            self.close()
            raise RecordingError(
                f'{self.path} is damaged: by its header it has {size} bytes'
            ) from error
        return _opened(f'file:{quote(str(copy))}?mode=ro&immutable=1')

    def _copy(self, logs: Iterable[Path]) -> Path:
        self._scratch = tempfile.TemporaryDirectory(prefix='explore_slam_')
        copy = Path(self._scratch.name) / self.path.name
        for source in (self.path, *logs):
            shutil.copyfile(source, copy.with_name(source.name))
        return copy

    def _survey(self) -> None:
        cursor = self._database.execute('SELECT id, name, type, serialization_format FROM topics')
        for number, name, kind, encoding in cursor:
            if encoding in ('cdr', '', None):
                self._topics[number] = name
                self.topics[name] = kind
                self.counts.setdefault(name, 0)
            else:
                self.unusable[name] = UnusableTopic(kind, f'{str(encoding).upper()} messages')
        try:
            query = 'SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages '
            found = self._database.execute(query + 'GROUP BY topic_id').fetchall()
        except sqlite3.DatabaseError as error:
            self._rows = sorted(self._readable(str(error)))
            times = [time for time, _, _ in self._rows]
            for _, _, topic in self._rows:
                if topic in self._topics:
                    self.counts[self._topics[topic]] += 1
        else:
            times = [time for _, _, *both in found for time in both]
            for topic, count, _, _ in found:
                if topic in self._topics:
                    self.counts[self._topics[topic]] += count
        if times:
            self.start, self.end = min(times), max(times)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or all, by log time."""
        wanted = {n: name for n, name in self._topics.items() if topics is None or name in topics}
        if not wanted:
            return
        last = (-(2**63), -1)
        if self._rows is None:
            query = (
                'SELECT timestamp, id, topic_id, data FROM messages WHERE topic_id IN '
                f'({",".join(map(str, wanted))}) ORDER BY timestamp, id'
            )
            try:
                for time, number, topic, data in self._database.execute(query):
                    yield self._message(wanted[topic], time, data)
                    last = (time, number)
            except sqlite3.DatabaseError as error:
                self._rows = sorted(self._readable(str(error)))
            else:
                return
        for time, number, topic in self._rows:
            if (time, number) <= last or topic not in wanted:
                continue
            try:
                query = 'SELECT data FROM messages WHERE id = ?'
                data = bytes(self._database.execute(query, (number,)).fetchone()[0])
            except (sqlite3.DatabaseError, TypeError) as error:
                self.damage(f'is damaged: row {{}} cannot be read ({error})', number)
                continue
            yield self._message(wanted[topic], time, data)

    def _message(self, topic: str, time: int, data: bytes) -> RawMessage:
        return RawMessage(topic, self.topics[topic], time, bytes(data))

    def _readable(self, reason: str) -> Iterator[tuple[int, int, int]]:
        """Yield (timestamp, id, topic) of all rows on pages that are not damaged."""
        query = 'SELECT timestamp, id, topic_id FROM messages WHERE id '
        highest = self._highest()
        last, found = self._lowest() - 1, 0
        while True:
            try:
                for row in self._database.execute(query + '> ? ORDER BY id', (last,)):
                    last = row[1]
                    if _is_row(row):
                        found += 1
                        yield row
                break
            except sqlite3.DatabaseError:
                pass
            end = last + _LONGEST_GAP if highest is None else highest
            for number in range(last + 1, end + 1):
                with suppress(sqlite3.DatabaseError):
                    row = self._database.execute(query + '= ?', (number,)).fetchone()
                    if row is not None and _is_row(row):
                        last = number
                        found += 1
                        yield row
                        break
            else:
                break
        self.damage(f'is damaged ({reason}): {found} rows can be read')

    def _lowest(self) -> int:
        return self._extreme('ASC') or 1

    def _highest(self) -> int | None:
        return self._extreme('DESC')

    def _extreme(self, order: str) -> int | None:
        """Return the first or last id, from the table or from one of its indices."""
        for query in (
            f'SELECT id FROM messages ORDER BY id {order} LIMIT 1',
            f'SELECT id FROM messages INDEXED BY timestamp_idx ORDER BY timestamp {order} LIMIT 1',
        ):
            with suppress(sqlite3.Error):
                row = self._database.execute(query).fetchone()
                if row is not None:
                    return int(row[0])
        return None


def _is_row(row: tuple[object, ...]) -> bool:
    """Return whether a row holds numbers: one on a page that is cut may not."""
    return all(isinstance(value, int) for value in row)


def _stated_size(path: Path) -> int:
    """Return the size (bytes) that the header of a database states."""
    with path.open('rb') as file:
        header = file.read(32)
    page = int.from_bytes(header[16:18], 'big')
    return (65536 if page == 1 else page) * int.from_bytes(header[28:32], 'big')


def _beside(path: Path, end: str) -> Path:
    return path.with_name(path.name + end)


def _opened(uri: str) -> sqlite3.Connection:
    database = sqlite3.connect(uri, uri=True)
    database.text_factory = lambda text: text.decode('utf-8', 'replace')
    return database
