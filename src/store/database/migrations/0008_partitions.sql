-- The workers that take records from the queue, and until when each of them counts as alive.
CREATE TABLE queue_workers (
    worker TEXT NOT NULL PRIMARY KEY,
    alive_until_ns BIGINT NOT NULL
);

-- The partitions of the queue that a worker owns; it owns them for as long as it counts as alive.
CREATE TABLE queue_partitions (
    partition_no BIGINT NOT NULL PRIMARY KEY,
    worker TEXT NOT NULL REFERENCES queue_workers (worker) ON DELETE CASCADE
);
CREATE INDEX queue_partitions_by_worker ON queue_partitions (worker);
