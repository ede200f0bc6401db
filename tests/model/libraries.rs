//! Libraries over wear, torque and speed: their contents, and that they do not depend on cancelling, resuming
//! and the number of threads.

use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use flankwatch::gear::{ContactRule, PairSpec, WearShape};
use flankwatch::library::{
    BuildControl, GridSettings, Library, LibraryCache, LibraryError, build, build_into, checkpoint_path,
    decode, encode,
};
use flankwatch::signal::OperatingPoint;

fn pair(contact: ContactRule) -> PairSpec {
    let mut spec = PairSpec::from_toml(include_str!("../../fixtures/pairs/shen2022.toml")).unwrap();
    spec.dynamics.contact = contact;
    spec
}

/// A grid of few wear states, three torques and two speeds.
fn grid() -> GridSettings {
    GridSettings {
        states: 9,
        seconds: 0.25,
        torque_factors: vec![0.5, 1.0, 1.5],
        speed_factors: vec![0.8, 1.0],
        ..GridSettings::default()
    }
}

fn on_threads(count: usize, pair: &PairSpec, grid: &GridSettings) -> Library {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
    pool.install(|| build(pair, grid, &BuildControl::silent()).unwrap())
}

fn at(torque_nm: Option<f64>, shaft_speed_hz: Option<f64>) -> OperatingPoint {
    OperatingPoint { shaft_speed_hz, torque_nm, ..OperatingPoint::default() }
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    for contact in [ContactRule::Threshold, ContactRule::Loaded] {
        let grid = GridSettings { states: 4, ..grid() };
        let [one, two] = [1, 2].map(|count| encode(&on_threads(count, &pair(contact), &grid)));
        assert!(one == two);
    }
}

#[test]
fn a_cancelled_build_resumes_and_gives_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept/grid.fwlib");
    let (pair, grid) = (pair(ContactRule::Threshold), grid());
    let whole = encode(&build(&pair, &grid, &BuildControl::silent()).unwrap());

    let stopped_after = |most: usize| {
        let (cancel, calls) = (AtomicBool::new(false), Mutex::new(Vec::new()));
        let progress = |done: usize, total: usize| {
            assert_eq!(total, 54);
            calls.lock().unwrap().push(done);
            if done >= most {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        let control = BuildControl::with_progress(&progress).cancelled_by(&cancel);
        let stopped = build_into(&path, &pair, &grid, &control);
        assert!(matches!(stopped, Err(LibraryError::Cancelled)), "{stopped:?}");
        let calls = calls.into_inner().unwrap();
        assert!(calls.iter().all(|done| *done < 54), "{calls:?}");
        calls
    };
    stopped_after(1);
    assert!(checkpoint_path(&path).exists() && !path.exists());
    stopped_after(25);
    // Finished simulations are not repeated: they are done at once.
    let kept = fs::read_to_string(checkpoint_path(&path)).unwrap();
    assert!(kept.lines().filter(|line| line.contains("\"torque\"")).count() >= 1);
    let least = AtomicUsize::new(usize::MAX);
    let progress = |done: usize, _| {
        least.fetch_min(done, Ordering::Relaxed);
    };
    let resumed = build_into(&path, &pair, &grid, &BuildControl::with_progress(&progress)).unwrap();
    assert!(least.into_inner() > 1);
    assert!(encode(&resumed) == whole);
    assert!(fs::read(&path).unwrap() == whole);
    assert!(!checkpoint_path(&path).exists());
}

#[test]
fn checkpoints_of_another_library_are_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grid.fwlib");
    let (pair, grid) = (pair(ContactRule::Threshold), GridSettings { states: 3, ..grid() });
    let other = GridSettings { seed: 2, ..grid.clone() };
    let wanted = encode(&build(&pair, &grid, &BuildControl::silent()).unwrap());
    let cancel = AtomicBool::new(false);
    let stop = |done: usize, _| cancel.store(done > 7, Ordering::Relaxed);
    build_into(&path, &pair, &other, &BuildControl::with_progress(&stop).cancelled_by(&cancel)).unwrap_err();
    assert!(fs::metadata(checkpoint_path(&path)).unwrap().len() > 1000);
    build_into(&path, &pair, &grid, &BuildControl::silent()).unwrap();
    assert!(fs::read(&path).unwrap() == wanted);
}

/// At a grid point the curves are those of a library for that point alone; half-way between two points they
/// are the mean, and outside the grid they are constant.
#[test]
fn curves_match_the_operating_point() {
    for contact in [ContactRule::Threshold, ContactRule::Loaded] {
        let (pair, grid) = (pair(contact), GridSettings { states: 3, ..grid() });
        let library = build(&pair, &grid, &BuildControl::silent()).unwrap();
        let mut heavy = pair.clone();
        heavy.operation.torque_nm *= 1.5;
        heavy.operation.output_torque_nm = heavy.operation.output_torque_nm.map(|torque| 1.5 * torque);
        heavy.operation.shaft_speed_hz *= 0.8;
        let nominal = GridSettings { torque_factors: vec![1.0], speed_factors: vec![1.0], ..grid.clone() };
        let alone = build(&heavy, &nominal, &BuildControl::silent()).unwrap();
        let (torque, speed) = (1950.0, 0.8 * 16.64);
        assert_eq!(library.feature_curves_at(&at(Some(torque), Some(speed))), alone.feature_curves());

        // The nominal states equal those of a library without other points.
        let plain = build(&pair, &nominal, &BuildControl::silent()).unwrap();
        assert_eq!(library.states(), plain.states());
        assert_eq!(library.feature_curves(), plain.feature_curves());
        assert_eq!(library.feature_curves_at(&at(None, None)), plain.feature_curves());
        let state = &plain.states()[2];
        assert_eq!(plain.feature_curves()["ln_mesh_1"][2], state.features.values["ln_mesh_1"]);

        let ends = [at(Some(1300.0), Some(speed)), at(Some(torque), Some(speed))]
            .map(|point| library.feature_curves_at(&point));
        let middle = library.feature_curves_at(&at(Some(1625.0), Some(speed)));
        for (name, curve) in &middle {
            for (i, value) in curve.iter().enumerate() {
                let mean = 0.5 * (ends[0][name][i] + ends[1][name][i]);
                assert!((value - mean).abs() < 1e-12, "{name}");
            }
        }
        assert_eq!(
            library.feature_curves_at(&at(Some(9e9), Some(1.0))),
            library.feature_curves_at(&at(Some(torque), Some(speed)))
        );
    }
}

/// A file of the previous format is not read; the cache rebuilds it.
#[test]
fn a_library_of_an_older_version_is_rebuilt() {
    let folder = tempfile::tempdir().unwrap();
    let (pair, grid) = (pair(ContactRule::Threshold), GridSettings { states: 2, ..grid() });
    let cache = LibraryCache::new(folder.path());
    let built = cache.get_or_build(&pair, &grid, &BuildControl::silent()).unwrap();
    let path = folder.path().join(built.id()).with_extension("fwlib");
    let bytes = fs::read(&path).unwrap();
    let older =
        String::from_utf8(bytes.clone()).unwrap().replacen("flankwatch-library 2", "flankwatch-library 1", 1);
    fs::write(&path, older).unwrap();
    assert!(matches!(cache.get(built.id()), Err(LibraryError::Version { found: 1, expected: 2 })));
    cache.get_or_build(&pair, &grid, &BuildControl::silent()).unwrap();
    assert!(fs::read(&path).unwrap() == bytes);
}

/// Ctrl-C ends the command with an error; the same command then completes the library.
#[cfg(unix)]
#[test]
fn ctrl_c_keeps_finished_simulations() {
    use std::process::{Command, Stdio};
    use std::thread::sleep;
    use std::time::Duration;

    let folder = tempfile::tempdir().unwrap();
    let build = |out: &Path, torques: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
        command.args(["library", "build", "--states", "24", "--seconds", "0.5", "--contact", "threshold"]);
        command.args(["--torques", torques, "--out"]).arg(out);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let torques = "0.5,0.6,0.7,0.8,0.9,1,1.1,1.2,1.3,1.4,1.5";
    let path = folder.path().join("grid.fwlib");
    let child = build(&path, torques).spawn().unwrap();
    while !fs::read_to_string(checkpoint_path(&path)).is_ok_and(|parts| parts.contains("\"torque\"")) {
        sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && words.contains("stopped before the library was complete"), "{words}");
    assert!(!path.exists());
    assert!(build(&path, torques).status().unwrap().success());
    let straight = folder.path().join("straight.fwlib");
    assert!(build(&straight, torques).status().unwrap().success());
    assert!(fs::read(&path).unwrap() == fs::read(&straight).unwrap());

    let refused = build(&straight, "0.5,1.5").output().unwrap();
    let words = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(words.contains("torques is [0.5, 1.5]") && words.contains("include 1"), "{words}");
}

/// Only states worn by Archard's law have a number of turns.
#[test]
fn archard_states_have_their_number_of_turns() {
    let mut spec = pair(ContactRule::Threshold);
    let grid = GridSettings { states: 3, max_wear_um: 10.0, seconds: 0.25, ..GridSettings::default() };
    let turns = |spec: &PairSpec| -> Vec<Option<f64>> {
        let library = decode(&encode(&build(spec, &grid, &BuildControl::silent()).unwrap())).unwrap();
        library.states().iter().map(|state| state.driving_turns).collect()
    };
    assert_eq!(turns(&spec), [None, None, None]);
    spec.wear.shape = WearShape::Archard;
    let worn = turns(&spec);
    assert_eq!(worn[0], Some(0.0));
    assert!(worn[1] > worn[0] && worn[2] > worn[1], "{worn:?}");
}
