//! API node and workers on one machine compared with the standalone service:
//! `cargo bench --features cluster --bench cluster`.
//!
//! Requires a PostgreSQL server at `FLANKWATCH_TEST_DATABASE` and a NATS server with JetStream at
//! `FLANKWATCH_TEST_NATS`. The workers own their partitions and are suspended while the queue is filled, so
//! that only the processor limits them; raw bytes are in a folder. The processor time of the servers is read
//! from `/proc` if they run on this machine. `FLANKWATCH_BENCH_WORKERS` sets the numbers of workers
//! (`1,2,4`), `FLANKWATCH_BENCH_AT_ONCE` the records that each processes at the same time.

#[expect(dead_code, reason = "other benches use more of it")]
mod driven;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use driven::{Service, Uploads, folder, load};
use sqlx::{Connection, PgConnection, Row};

/// Number of records of 10 s in each measurement.
const RECORDS: usize = 400;

/// Number of assets, so that every worker has channels.
const ASSETS: usize = 16;

/// Time in which workers get their shares of the partitions: also those of the worker that is killed before.
const SHARED_AFTER: Duration = Duration::from_secs(18);

fn main() {
    let env = |name: &str| std::env::var(name).ok();
    let (Some(database), Some(nats)) = (env("FLANKWATCH_TEST_DATABASE"), env("FLANKWATCH_TEST_NATS")) else {
        println!("skipped: set FLANKWATCH_TEST_DATABASE and FLANKWATCH_TEST_NATS");
        return;
    };
    let alone = single_machine();
    println!("one machine: {alone:.1} records a second");
    let counts = env("FLANKWATCH_BENCH_WORKERS").unwrap_or_else(|| "1,2,4".to_owned());
    for workers in counts.split(',').filter_map(|count| count.parse().ok()) {
        let rate = queued(&database, &nats, workers);
        println!(
            "{workers} workers: {rate:.1} records a second, {:.2} of one machine on the same cores",
            rate / alone
        );
    }
}

fn asset(n: usize) -> String {
    format!("pump-{}", n % ASSETS)
}

/// Returns the records per second that one process accepts, analyses and stores, once the pair is simulated.
fn single_machine() -> f64 {
    let service = Service::start(&folder("alone"));
    (0..ASSETS).for_each(|n| service.make_asset(&asset(n)));
    let records = Uploads::new();
    let (_, user_before, system_before) = service.used();
    let (seconds, _) = load(&service, 8, RECORDS, None, |n, stream| records.send(stream, &asset(n), 0, n));
    let (_, user, system) = service.used();
    println!(
        "one machine: a record costs {:.1} ms of processor time",
        1e3 * (user + system - user_before - system_before) / RECORDS as f64
    );
    RECORDS as f64 / seconds
}

/// Returns the records per second that workers process from a filled queue.
fn queued(database: &str, nats: &str, workers: usize) -> f64 {
    let shared = folder("shared");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let name = format!("bench_{}_{workers}", std::process::id());
    let schema = Schema::make(&runtime, database, &name);
    let config = config(&shared, &format!("{database}?options[search_path]={name}"), nats, &name);
    let config = config.to_str().expect("a path in UTF-8");
    let api =
        Service::start_as(&["serve", "--listen", "127.0.0.1:0", "--config", config], &shared.join("api"));
    let worker = |n: usize| {
        Service::start_as(
            &["work", "--health", "127.0.0.1:0", "--config", config],
            &shared.join(format!("worker-{n}")),
        )
    };
    {
        // Simulates the library.
        let first = worker(0);
        (0..ASSETS).for_each(|n| api.make_asset(&asset(n)));
        first.wait_until_idle();
    }
    let all: Vec<Service> = (0..workers).map(|n| worker(n + 1)).collect();
    std::thread::sleep(SHARED_AFTER);
    all.iter().for_each(|worker| signal(worker, "STOP"));
    let records = Uploads::new();
    let (_, user_before, system_before) = api.used();
    let (seconds, _) = load(&api, 8, RECORDS, None, |n, stream| records.send(stream, &asset(n), 0, n));
    let (_, user, system) = api.used();
    println!(
        "{workers} workers: the API node enqueues {:.0} records a second first, {:.1} ms of its processor time each",
        RECORDS as f64 / seconds,
        1e3 * (user + system - user_before - system_before) / RECORDS as f64
    );
    all.iter().for_each(|worker| signal(worker, "CONT"));
    // Excludes what the workers read at first, for example libraries.
    let begin = schema.wait_for(&runtime, RECORDS / 8);
    let (before, servers_before) = (cost(&all), servers());
    let began = Instant::now();
    let end = schema.wait_for(&runtime, RECORDS);
    let (seconds, done) = (began.elapsed().as_secs_f64(), (end - begin) as f64);
    println!(
        "{workers} workers: a record costs {:.1} ms of the workers' processor time, {:.1} ms of PostgreSQL's and {:.1} ms of NATS's",
        1e3 * (cost(&all) - before) / done,
        1e3 * (servers().0 - servers_before.0) / done,
        1e3 * (servers().1 - servers_before.1) / done
    );
    drop((all, api));
    runtime.block_on(remove_streams(nats, &name));
    let _ = fs::remove_dir_all(&shared);
    done / seconds
}

async fn remove_streams(nats: &str, name: &str) {
    let client = async_nats::connect(nats).await.expect("the NATS server");
    let jetstream = async_nats::jetstream::new(client);
    for stream in ["work", "dead", "events"] {
        let _ = jetstream.delete_stream(format!("{name}_{stream}")).await;
    }
}

fn signal(service: &Service, name: &str) {
    let sent = Command::new("kill").args(["-s", name, &service.child.id().to_string()]).status();
    assert!(sent.is_ok_and(|status| status.success()), "the signal {name} to a worker");
}

/// Returns the CPU seconds of processes.
fn cost(services: &[Service]) -> f64 {
    services.iter().map(|service| service.used()).map(|(_, user, system)| user + system).sum()
}

/// Returns the CPU seconds of PostgreSQL and of the NATS server on this machine.
fn servers() -> (f64, f64) {
    let mut seconds = (0.0, 0.0);
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let stat = fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        let Some((name, rest)) = stat.split_once('(').and_then(|(_, rest)| rest.rsplit_once(") ")) else {
            continue;
        };
        let ticks: Vec<f64> = rest.split(' ').map(|field| field.parse().unwrap_or(0.0)).collect();
        // Includes the children that have ended.
        let used: f64 = ticks.get(11..15).map_or(0.0, |ticks| ticks.iter().sum());
        match name {
            "postgres" => seconds.0 += used / 100.0,
            "nats-server" => seconds.1 += used / 100.0,
            _ => {}
        }
    }
    seconds
}

fn config(shared: &Path, database: &str, nats: &str, name: &str) -> PathBuf {
    let path = shared.join("cluster.toml");
    let objects = shared.join("objects");
    let text = format!(
        "[cluster]\nname = \"{name}\"\n[cluster.database]\nurl = \"{database}\"\n[cluster.nats]\nurls = [\"{nats}\"]\n\
         [cluster.objects]\nfolder = \"{}\"\n{}",
        objects.display(),
        std::env::var("FLANKWATCH_BENCH_AT_ONCE")
            .map_or(String::new(), |count| format!("[cluster.worker]\nat_once = {count}\n")),
    );
    fs::write(&path, text).expect("room for the settings");
    path
}

/// A temporary schema, dropped at the end.
struct Schema {
    database: String,
    name: String,
}

impl Schema {
    fn make(runtime: &tokio::runtime::Runtime, database: &str, name: &str) -> Self {
        let schema = Self { database: database.to_owned(), name: name.to_owned() };
        runtime.block_on(schema.run(&format!("CREATE SCHEMA {name}")));
        schema
    }

    async fn run(&self, statement: &str) {
        let mut connection = PgConnection::connect(&self.database).await.expect("the database");
        sqlx::raw_sql(statement).execute(&mut connection).await.expect("a statement");
    }

    /// Waits until `records` are stored; returns the number stored by then.
    fn wait_for(&self, runtime: &tokio::runtime::Runtime, records: usize) -> usize {
        let statement = format!("SELECT COALESCE(SUM(segments), 0)::bigint FROM {}.channels", self.name);
        runtime.block_on(async {
            let mut connection = PgConnection::connect(&self.database).await.expect("the database");
            loop {
                let row = sqlx::query(&statement).fetch_one(&mut connection).await.expect("a count");
                let stored: i64 = row.get(0);
                if stored as usize >= records {
                    return stored as usize;
                }
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        })
    }
}

impl Drop for Schema {
    fn drop(&mut self) {
        if let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() {
            runtime.block_on(self.run(&format!("DROP SCHEMA {} CASCADE", self.name)));
        }
    }
}
