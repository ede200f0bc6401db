//! `flankwatch demo`: the service with a simulated gearbox that wears while the user watches.

mod live;

use std::fs;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use tokio::sync::watch;

use super::serve::{shutdown_signal, socket_address};
use crate::asset::{
    AssetId, AssetSpec, BaselineSpec, GearSpec, Location, SensorSpec, StreamSpec, WearLimits,
};
use crate::cli::simulation::pair_file;
use crate::cli::{CliError, output};
use crate::estimate::{Inspection, MaintenanceEvent, MaintenanceKind};
use crate::gear::ContactRule;
use crate::http::{RunningService, ServiceConfig, StartError, start};
use crate::library::{EnsembleSettings, FlankPlace};
use crate::recording::{BlockEncoding, encode_block};
use crate::service::{Clock, RecordFormat, Service, ServiceError, SystemClock, UploadMetadata};
use crate::signal::{EnvelopeSearch, Record};
use crate::simulation::{Run, RunPlan};

/// Identifier of the demonstration asset.
const ASSET: &str = "demo-gearbox";

/// Seconds from the start of one record to the start of the next.
const INTERVAL_S: f64 = 60.0;

/// Wear depth of the last record: above the warning limit and below the danger limit, so that the run shows
/// both an alarm and a forecast.
const MAX_WEAR_UM: f64 = 190.0;

/// Standard error of the inspection half-way: typical of a replica measured under a microscope.
const INSPECTION_ERROR_UM: f64 = 5.0;

/// Arguments of `flankwatch demo`.
#[derive(Args)]
pub(in crate::cli) struct DemoArgs {
    /// Address to listen on; port 0 picks a free port [default: 127.0.0.1:8600, or a free port if it is in
    /// use]
    #[arg(long, value_name = "ADDR", value_parser = socket_address)]
    listen: Option<SocketAddr>,
    /// Folder to keep the demonstration's data in [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    data_dir: Option<PathBuf>,
    /// Number of records in the run
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(30..=10_000))]
    records: u32,
    /// Records replayed per second
    #[arg(long, default_value_t = 5.0)]
    speed: f64,
    /// Random seed of the run
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Runs the command until Ctrl-C.
pub(in crate::cli) fn run(args: &DemoArgs) -> Result<(), CliError> {
    if !(args.speed > 0.0 && args.speed <= 1000.0) {
        return Err(CliError::Argument(format!(
            "--speed is {}, expected a number above 0 and at most 1000",
            args.speed
        )));
    }
    let temporary = std::env::temp_dir().join(format!("flankwatch-demo-{}", std::process::id()));
    let data_dir = args.data_dir.clone().unwrap_or_else(|| temporary.clone());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(CliError::file(&data_dir))?;
    let ended = runtime.block_on(serve_and_replay(args, data_dir));
    runtime.shutdown_timeout(Duration::from_secs(1));
    if args.data_dir.is_none()
        && let Err(error) = fs::remove_dir_all(&temporary)
        && error.kind() != ErrorKind::NotFound
    {
        tracing::warn!(folder = %temporary.display(), %error, "failed to remove the demonstration's data");
    }
    ended
}

async fn serve_and_replay(args: &DemoArgs, data_dir: PathBuf) -> Result<(), CliError> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock);
    let service = start_on_free_port(args.listen, data_dir, clock.clone()).await?;
    output::print(&format!(
        "dashboard: http://{}/#/assets/{ASSET}\nreplaying a run towards the danger limit for about {:.0} s, with an inspection half-way; press Ctrl-C to stop\n",
        service.address(),
        f64::from(args.records) / args.speed,
    ))?;
    let (latest_sender, latest) = watch::channel(None);
    let live = tokio::spawn(live::send(service.service().clone(), sample_id()?, latest));
    let replay = tokio::select! {
        stopped = shutdown_signal() => stopped.map(|()| true).map_err(CliError::file("signals")),
        replayed = replay(service.service(), args, clock.now(), &latest_sender) => replayed.map(|()| false),
    };
    let outcome = match replay {
        Ok(false) => {
            output::print("run complete; the dashboard stays available until Ctrl-C\n")?;
            shutdown_signal().await.map_err(CliError::file("signals"))
        }
        Ok(true) => Ok(()),
        Err(error) => Err(error),
    };
    live.abort();
    service.stop().await?;
    outcome
}

/// Starts the service on the given address, or on the default port, or on a free port if that is in use.
async fn start_on_free_port(
    listen: Option<SocketAddr>,
    data_dir: PathBuf,
    clock: Arc<dyn Clock>,
) -> Result<RunningService, CliError> {
    let default = SocketAddr::from((Ipv4Addr::LOCALHOST, 8600));
    let config = |address| {
        let mut config = ServiceConfig::new(address, &data_dir);
        // The run takes about a minute, and simulating the whole ensemble would take as long.
        config.work.ensemble = EnsembleSettings::default().first();
        config
    };
    match start(config(listen.unwrap_or(default)), clock.clone()).await {
        Err(StartError::Listen { source, .. })
            if listen.is_none() && source.kind() == ErrorKind::AddrInUse =>
        {
            Ok(start(config((Ipv4Addr::LOCALHOST, 0).into()), clock).await?)
        }
        started => Ok(started?),
    }
}

/// Creates the demonstration asset and sends it a simulated run that ends about now.
async fn replay(
    service: &Arc<Service>,
    args: &DemoArgs,
    now: Timestamp,
    latest: &watch::Sender<Option<Arc<Record>>>,
) -> Result<(), CliError> {
    let mut pair = pair_file::read(None)?;
    pair.dynamics.contact = ContactRule::Loaded;
    let id = sample_id()?;
    let asset = AssetSpec {
        id: id.clone(),
        name: "Demonstration gearbox".to_owned(),
        location: Location::default(),
        gear: Some(GearSpec {
            teeth: pair.geometry.teeth,
            shaft_speed_hz: pair.operation.shaft_speed_hz,
            shaft_ratio: None,
            other_meshes: Vec::new(),
            speed_tolerance: 0.05,
            speed_is_exact: false,
            pair: Some(pair.clone()),
        }),
        shaft: None,
        bearings: Vec::new(),
        velocity_zones: None,
        sensor: SensorSpec::default(),
        points: Vec::new(),
        baseline: BaselineSpec::default(),
        limits: WearLimits { warning_um: Some(120.0), danger_um: Some(200.0) },
        alarms: None,
        operating_bins: Vec::new(),
        envelope_band_hz: None,
        envelope_band: EnvelopeSearch::default(),
        gear_indicators: true,
        bands: Vec::new(),
        // Only the simulated run becomes records, not the live stream.
        stream: StreamSpec { interval_s: 0.0, ..StreamSpec::default() },
    };
    match service.assets.create(&asset).await {
        // With --data-dir the asset may exist from an earlier run.
        Ok(_) | Err(ServiceError::Store(crate::store::StoreError::AssetExists(_))) => {}
        Err(error) => return Err(error.into()),
    }
    let run = Run::new(RunPlan {
        pair,
        records: args.records,
        seconds: 2.0,
        sample_rate_hz: 20_000.0,
        max_wear_um: MAX_WEAR_UM,
        wear_exponent: 1.5,
        start_time: now - SignedDuration::from_secs_f64(INTERVAL_S * f64::from(args.records)),
        interval_s: INTERVAL_S,
        snr_db: 10.0,
        speed_variation: 0.005,
        torque_variation: 0.02,
        seed: args.seed,
        channel: "gearbox/x".to_owned(),
    })?;
    let run = Arc::new(run);
    let mut due = tokio::time::interval(Duration::from_secs_f64(1.0 / args.speed));
    for index in 0..args.records {
        due.tick().await;
        let run = run.clone();
        let simulated = service.workers.run("simulate a record", move || run.record(index)).await??;
        let metadata =
            UploadMetadata { reference_wear_um: Some(simulated.wear_um), ..UploadMetadata::default() };
        let bytes = encode_block(&simulated.record, BlockEncoding::Protobuf).into();
        if index == args.records / 2 {
            let inspected = inspection(simulated.record.start_time(), simulated.wear_um);
            service.maintenance.add(&id, inspected).await?;
        }
        latest.send_replace(Some(Arc::new(simulated.record)));
        let ticket = service.workers.admit()?;
        service.pipeline.accept(&id, RecordFormat::Protobuf, bytes, metadata, ticket).await?;
    }
    Ok(())
}

fn sample_id() -> Result<AssetId, CliError> {
    AssetId::new(ASSET).map_err(|error| CliError::Argument(error.to_string()))
}

/// Returns an inspection with the wear rounded to a whole micrometre, as read under a microscope.
fn inspection(time: Timestamp, wear_um: f64) -> MaintenanceEvent {
    MaintenanceEvent {
        time,
        kind: MaintenanceKind::Inspected,
        by: "Demonstration".to_owned(),
        comment: "replica of the flanks, read under a microscope".to_owned(),
        inspection: Some(Inspection {
            depth_um: wear_um.round(),
            error_um: INSPECTION_ERROR_UM,
            gear: None,
            place: FlankPlace::Greatest,
        }),
        until: None,
    }
}
