//! Condition indicators of a WAV recording.
//!
//! `cargo run -p flankwatch-recording --example indicators_of_a_wav [FILE.wav TEETH SHAFT_HZ]`
//!
//! Without a file, it analyses a generated recording: the mesh of a gear with 24 teeth at 25 Hz, three
//! harmonics with sidebands.

use std::error::Error;
use std::f64::consts::TAU;
use std::io::Cursor;

use flankwatch_recording::{RecordDefaults, WavWriter, decode_wav};
use flankwatch_signal::{
    AnalysisSettings, Analyzer, BearingSettings, ConditionSettings, Indicators, MeshContext,
};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (bytes, teeth, shaft_speed_hz) = match arguments.as_slice() {
        [] => (made_up()?, 24, 25.0),
        [file, teeth, shaft] => (std::fs::read(file)?, teeth.parse()?, shaft.parse()?),
        _ => return Err("expected no argument, or FILE.wav TEETH SHAFT_HZ".into()),
    };
    // WAV has no unit: the caller knows it.
    let defaults = RecordDefaults { unit: Some("m/s2".to_owned()), ..RecordDefaults::default() };
    let settings = ConditionSettings {
        mesh: MeshContext::new([teeth, 0], shaft_speed_hz, 0.05),
        bands: &[],
        gear_indicators: true,
        bearings: BearingSettings::default(),
    };
    // One analyzer for all records: it keeps what it has planned.
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    for record in decode_wav(&bytes, &defaults)? {
        let analysis = analyzer.condition(&record, &settings).analysis;
        println!("channel {}, {:.2} s", record.channel(), record.duration_s());
        if let Some(speed) = analysis.shaft_speed {
            println!("  shaft {:.3} Hz, mesh {:.2} Hz", speed.shaft_speed_hz, speed.mesh_frequency_hz);
        }
        for (name, value) in &analysis.indicators.values {
            println!("  {name} = {value:.6} {}", Indicators::unit(name, record.unit(), &[]));
        }
        for (name, reason) in &analysis.indicators.absent {
            println!("  {name} is absent: {reason:?}");
        }
    }
    Ok(())
}

/// Four seconds at 20 kHz.
fn made_up() -> Result<Vec<u8>, Box<dyn Error>> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut bytes, 1, 20_000.0)?;
    for i in 0..80_000 {
        let turn = TAU * 25.0 * f64::from(i) / 20_000.0;
        let mesh: f64 = (1..=3).map(|h| (24.0 * f64::from(h) * turn).sin() / f64::from(h)).sum();
        writer.write_frame(&[((1.0 + 0.1 * turn.cos()) * mesh) as f32])?;
    }
    writer.finish()?;
    Ok(bytes.into_inner())
}
