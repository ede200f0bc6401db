"""Multiplies the records in a stopped service's data folder by ten, under other names and at later times.

    python3 benches/multiply_rows.py DATA_FOLDER

For measurements with more rows than can be sent in a few minutes. Only rows of the SQLite database are
copied, no raw recordings. The columns of histories are removed; the service stores them anew.
"""

import sqlite3
import sys

TABLES = {
    "segments": "id",
    "analyses": "segment_id",
    "wear_estimates": "segment_id",
    "wear_posteriors": "segment_id",
}


def main() -> None:
    database = sqlite3.connect(f"{sys.argv[1]}/flankwatch.db")
    database.execute("PRAGMA foreign_keys = off")
    database.execute("PRAGMA synchronous = off")
    first, last = database.execute("SELECT min(start_time_ns), max(start_time_ns) FROM segments").fetchone()
    span = last - first + 60 * 10**9
    # The digit after the time in a record's identifier becomes a letter that no identifier has there.
    for copy, letter in enumerate("ghijklmno", start=1):
        renamed = f"substr(t.{{0}}, 1, 9) || '{letter}' || substr(t.{{0}}, 11)"
        for table, identifier in TABLES.items():
            columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            values = {name: f"t.{name}" for name in columns}
            values[identifier] = renamed.format(identifier)
            if table == "segments":
                values["start_time_ns"] = f"t.start_time_ns + {copy * span}"
            database.execute(
                f"INSERT INTO {table} ({', '.join(columns)}) SELECT {', '.join(values.values())}"
                f" FROM {table} t JOIN segments s ON s.id = t.{identifier} WHERE s.start_time_ns <= {last}"
            )
    database.execute("DELETE FROM trend_blocks")
    database.execute(
        "UPDATE channels SET (last_start_ns, last_segment_id) = (SELECT start_time_ns, id FROM segments s"
        " WHERE s.channel_no = channels.channel_no ORDER BY start_time_ns DESC, id DESC LIMIT 1),"
        " segments = (SELECT count(*) FROM segments s WHERE s.channel_no = channels.channel_no)"
    )
    database.commit()
    print(database.execute("SELECT count(*) FROM segments").fetchone()[0], "records")


if __name__ == "__main__":
    main()
