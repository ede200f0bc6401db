-- The interval of a wear depth is no longer one of quantiles.

ALTER TABLE wear_estimates RENAME COLUMN p05_um TO low_um;
ALTER TABLE wear_estimates RENAME COLUMN p95_um TO high_um;
UPDATE wear_estimates
    SET estimate = replace(replace(estimate, '"p05_um":', '"low_um":'), '"p95_um":', '"high_um":');
