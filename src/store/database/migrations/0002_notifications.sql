-- Notifications of alarms, one row for each recipient: written with the change that they tell of.
CREATE TABLE notifications (
    id TEXT NOT NULL,
    recipient TEXT NOT NULL,
    alarm_id TEXT NOT NULL,
    -- Rises with the notifications of an alarm.
    number BIGINT NOT NULL,
    notification TEXT NOT NULL,
    noted_at_ns BIGINT NOT NULL,
    -- `waiting`, `sent` or `given_up`.
    progress TEXT NOT NULL,
    attempts BIGINT NOT NULL,
    -- When it is tried next. Who tries it moves this behind the time that the attempt may take.
    due_at_ns BIGINT NOT NULL,
    ended_at_ns BIGINT,
    -- Why the latest attempt failed.
    error TEXT,
    PRIMARY KEY (id, recipient)
);
CREATE INDEX notifications_due ON notifications (recipient, due_at_ns) WHERE progress = 'waiting';
CREATE INDEX notifications_waiting ON notifications (alarm_id, recipient, number) WHERE progress = 'waiting';
CREATE INDEX notifications_ended ON notifications (ended_at_ns);

-- Which severity of an alarm was noted last for those who are notified, and how many notifications it had.
ALTER TABLE alarms ADD COLUMN told_severity TEXT;
ALTER TABLE alarms ADD COLUMN told_number BIGINT NOT NULL DEFAULT 0;
