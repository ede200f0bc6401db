//! A model of fleets that nobody can run here: from the measured cost of a record it computes what 10³ to 10⁶
//! machines need, and simulates how long their records wait.
//!
//!     cargo bench --bench fleet
//!
//! Each machine has four measuring points and sends a record of 10 s from each every ten minutes. A fifth of
//! the machines have synchronised clocks and send within the same second; the others are spread evenly. The
//! costs are those of docs/scaling.md.

/// Records of a machine every [`INTERVAL_S`].
const POINTS: f64 = 4.0;
const INTERVAL_S: usize = 600;

/// Share of the machines that send within the first second of each interval.
const SYNCHRONISED: f64 = 0.2;

/// Processor time of a record in seconds: a worker, PostgreSQL, NATS, an API node.
const WORKER_S: f64 = 5.7e-3;
const DATABASE_S: f64 = 1.5e-3;
const QUEUE_S: f64 = 0.5e-3;
const NODE_S: f64 = 2.7e-3;

/// Bytes of a record: raw, rows with indexes, write-ahead log.
const RAW_BYTES: f64 = 800e3;
const ROW_BYTES: f64 = 4.4e3;
const LOG_BYTES: f64 = 26e3;

/// Bytes of a channel's stored states of the fold.
const STATE_BYTES: f64 = 3e6;

/// Partitions of the queue, cores of a worker, and the load at which a part counts as full.
const PARTITIONS: usize = 64;
const WORKER_CORES: f64 = 2.0;
const FULL: f64 = 0.7;

/// Cores of the database's server, and what its disk writes in a second.
const DATABASE_CORES: f64 = 32.0;
const DATABASE_BYTES_PER_S: f64 = 500e6;

/// Cores that one NATS server can use for a stream: its messages pass one leader.
const QUEUE_CORES: f64 = 4.0;

const DAY_S: f64 = 86_400.0;

/// Numerical Recipes' linear congruential generator: the same fleet in every run.
struct Generator(u32);

impl Generator {
    /// A number between 0 and 1.
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (f64::from(self.0) + 0.5) / 4_294_967_296.0
    }

    /// A count with this mean: Poisson, or normal where that is the same.
    fn count(&mut self, mean: f64) -> f64 {
        if mean > 50.0 {
            let normal: f64 = (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0;
            return (mean + mean.sqrt() * normal).round().max(0.0);
        }
        let (limit, mut product, mut count) = ((-mean).exp(), self.uniform(), 0.0);
        while product > limit {
            product *= self.uniform();
            count += 1.0;
        }
        count
    }
}

/// How long the records of a fleet wait for their worker, in seconds.
struct Waits {
    median: f64,
    most: f64,
}

/// Simulates three intervals, second by second. Channels are hashed to partitions, and each worker owns an
/// equal number of them.
fn waits(machines: f64, workers: usize) -> Waits {
    let mut generator = Generator(7);
    let shares: Vec<f64> =
        (0..PARTITIONS).map(|_| generator.count(machines * POINTS / PARTITIONS as f64)).collect();
    let mut channels = vec![0.0; workers];
    for (partition, share) in shares.iter().enumerate() {
        channels[partition % workers] += share;
    }
    let mut backlogs = vec![0.0; workers];
    let mut waits: Vec<(f64, f64)> = Vec::new();
    for second in 0..3 * INTERVAL_S {
        for (channels, backlog) in channels.iter().zip(&mut backlogs) {
            let spread = generator.count(channels * (1.0 - SYNCHRONISED) / INTERVAL_S as f64);
            let synchronised = if second % INTERVAL_S == 0 { channels * SYNCHRONISED } else { 0.0 };
            let arrived = spread + synchronised;
            // A record waits for half of those that arrive with it.
            waits.push(((*backlog + arrived / 2.0) * WORKER_S / WORKER_CORES, arrived));
            *backlog = (*backlog + arrived - WORKER_CORES / WORKER_S).max(0.0);
        }
    }
    waits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = waits.iter().map(|(_, records)| records).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let median = waits.iter().find(|(_, records)| {
        sum += records;
        sum >= half
    });
    Waits { median: median.map_or(0.0, |wait| wait.0), most: waits.last().map_or(0.0, |wait| wait.0) }
}

fn bytes(bytes: f64) -> String {
    match bytes {
        b if b < 1e10 => format!("{:.1} GB", b / 1e9),
        b if b < 1e12 => format!("{:.0} GB", b / 1e9),
        b if b < 1e15 => format!("{:.1} TB", b / 1e12),
        b => format!("{:.1} PB", b / 1e15),
    }
}

fn main() {
    println!(
        "| machines | records/s | workers | wait: median, longest | API cores | database cores | its log | NATS cores | raw a day | rows a day | states |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for machines in [1e3, 1e4, 1e5, 1e6] {
        let rate = machines * POINTS / INTERVAL_S as f64;
        let workers = (rate * WORKER_S / WORKER_CORES / FULL).ceil().clamp(2.0, PARTITIONS as f64) as usize;
        let Waits { median, most } = waits(machines, workers);
        println!(
            "| {machines:.0} | {rate:.1} | {workers} | {median:.2} s, {most:.0} s | {:.2} | {:.2} | {:.1} MB/s | {:.2} | {} | {} | {} |",
            rate * NODE_S,
            rate * DATABASE_S,
            rate * LOG_BYTES / 1e6,
            rate * QUEUE_S,
            bytes(rate * RAW_BYTES * DAY_S),
            bytes(rate * ROW_BYTES * DAY_S),
            bytes(machines * POINTS * STATE_BYTES),
        );
    }
    println!("\nWhere each part is full (at {:.0} % of it):", 100.0 * FULL);
    let machines = |rate: f64| rate * INTERVAL_S as f64 / POINTS;
    for (part, rate) in [
        ("64 workers, one for each partition", FULL * PARTITIONS as f64 * WORKER_CORES / WORKER_S),
        ("database, processor of 32 cores", FULL * DATABASE_CORES / DATABASE_S),
        ("database, disk of 500 MB/s", FULL * DATABASE_BYTES_PER_S / (LOG_BYTES + ROW_BYTES)),
        ("NATS, leader of the stream on 4 cores", FULL * QUEUE_CORES / QUEUE_S),
        ("bucket, 10 Gbit/s in and out", FULL * 1.25e9 / RAW_BYTES),
    ] {
        println!("- {part}: {rate:.0} records/s, {:.1e} machines", machines(rate));
    }
}
