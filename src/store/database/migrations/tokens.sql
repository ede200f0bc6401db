-- Who may use the service. Not the tokens: their hashes.
CREATE TABLE IF NOT EXISTS tokens (
    id TEXT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    scope TEXT NOT NULL,
    created_at_ns BIGINT NOT NULL,
    sha256 TEXT NOT NULL,
    revoked_at_ns BIGINT
);
