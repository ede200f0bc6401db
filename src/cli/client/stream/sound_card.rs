//! A sound card as a source of samples, through ALSA.

use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use alsa::pcm::{Access, Format, HwParams, PCM, State};
use alsa::{Direction, ValueOr};

use super::capture::{Capture, CaptureDevice, CaptureRead, MonotonicClock};
use crate::cli::CliError;
use crate::recording::RawSample;
use crate::recording::stream::StreamFormat;

/// Length of the device's buffer in microseconds, which is how late it may be read, and that of its parts.
const BUFFER_US: u32 = 1_000_000;
const PERIOD_US: u32 = 50_000;

/// Longest wait for samples in milliseconds, after which Ctrl-C is noticed.
const WAIT_MS: u32 = 100;

/// What is wanted of a device.
pub(super) struct WantedFormat {
    /// The type of its samples, if it must be this one.
    pub(super) sample: Option<RawSample>,
    pub(super) rate_hz: f64,
    pub(super) channels: u32,
    pub(super) scale: Option<f64>,
}

/// A device of ALSA, opened for capture.
pub(super) struct SoundCard {
    name: String,
    pcm: PCM,
    frame_bytes: usize,
    /// Frames read at once.
    period_frames: usize,
    clock: MonotonicClock,
}

impl SoundCard {
    /// Opens a device by its name, such as `hw:1`. It samples from the first read on.
    ///
    /// # Errors
    /// There is no such device, it is in use, or it does not offer the format.
    pub(super) fn open(
        name: &str,
        wanted: &WantedFormat,
        stop: Arc<AtomicBool>,
    ) -> Result<Capture<Self>, CliError> {
        // Not blocking: a device in use is an error at once.
        let pcm = PCM::new(name, Direction::Capture, true).map_err(failed(name, "open the device"))?;
        let (format, period_frames) = set_up(name, &pcm, wanted)?;
        let frame_bytes = format.frame_bytes();
        let clock = MonotonicClock::new();
        let card = Self { name: name.to_owned(), pcm, frame_bytes, period_frames, clock };
        Ok(Capture::new(card, format, stop))
    }
}

impl CaptureDevice for SoundCard {
    fn start(&mut self) -> Result<(), CliError> {
        self.pcm.prepare().and_then(|()| self.pcm.start()).map_err(failed(&self.name, "start the device"))
    }

    fn read(&mut self, frames: &mut [u8]) -> Result<CaptureRead, CliError> {
        let most = frames.len().min(self.period_frames * self.frame_bytes);
        let read = self.pcm.wait(Some(WAIT_MS)).and_then(|is_ready| match is_ready {
            true => self.pcm.io_bytes().readi(&mut frames[..most]).map(Some),
            false => Ok(None),
        });
        match read {
            Ok(Some(0)) => Ok(CaptureRead::End),
            Ok(read) => Ok(CaptureRead::Frames(read.unwrap_or(0))),
            Err(_) if matches!(self.pcm.state(), State::XRun | State::Suspended) => Ok(CaptureRead::Overrun),
            Err(error) => match io::Error::from_raw_os_error(error.errno()).kind() {
                io::ErrorKind::Interrupted | io::ErrorKind::WouldBlock => Ok(CaptureRead::Frames(0)),
                _ => Err(failed(&self.name, "read samples")(error)),
            },
        }
    }

    fn buffered_frames(&self) -> Option<u64> {
        u64::try_from(self.pcm.avail().ok()?).ok()
    }

    fn monotonic_time(&self) -> Duration {
        self.clock.time()
    }
}

/// Sets the format of a device; returns it with the number of frames of a part of its buffer.
fn set_up(name: &str, pcm: &PCM, wanted: &WantedFormat) -> Result<(StreamFormat, usize), CliError> {
    let set_failed = || failed(name, "set up the device");
    let params = HwParams::any(pcm).map_err(set_failed())?;
    params.set_access(Access::RWInterleaved).map_err(set_failed())?;
    let samples = [(RawSample::F32, Format::FloatLE), (RawSample::I16, Format::S16LE)];
    let is_offered = |(sample, format): &(RawSample, Format)| {
        wanted.sample.is_none_or(|wanted| wanted == *sample) && params.test_format(*format).is_ok()
    };
    let Some((sample, format)) = samples.into_iter().find(is_offered) else {
        let expected = wanted.sample.map_or("f32 or i16", RawSample::name);
        let hint = format!("a device that offers {expected}, such as plug:'{name}', which converts");
        return Err(CliError::Argument(format!("--alsa is {name}, expected {hint}")));
    };
    params.set_format(format).map_err(set_failed())?;
    let unfit = |option: &str, value: String, least: Option<u32>, most: Option<u32>| {
        let (least, most) = (least.unwrap_or(0), most.unwrap_or(u32::MAX));
        CliError::Argument(format!(
            "{option} is {value}, expected a value that {name} offers, from {least} to {most}"
        ))
    };
    if params.set_channels(wanted.channels).is_err() {
        let (least, most) = (params.get_channels_min().ok(), params.get_channels_max().ok());
        return Err(unfit("--channels", wanted.channels.to_string(), least, most));
    }
    let rate = Some(wanted.rate_hz).filter(|rate| rate.fract() == 0.0).map(|rate| rate as u32);
    if rate.is_none_or(|rate| params.set_rate(rate, ValueOr::Nearest).is_err()) {
        let (least, most) = (params.get_rate_min().ok(), params.get_rate_max().ok());
        return Err(unfit("--rate", wanted.rate_hz.to_string(), least, most));
    }
    params.set_buffer_time_near(BUFFER_US, ValueOr::Nearest).map_err(set_failed())?;
    params.set_period_time_near(PERIOD_US, ValueOr::Nearest).map_err(set_failed())?;
    pcm.hw_params(&params).map_err(set_failed())?;
    let period = params.get_period_size().map_err(set_failed())?;
    let format = StreamFormat::new(sample, wanted.rate_hz, wanted.channels, wanted.scale);
    let format = format.map_err(|error| CliError::Argument(error.to_string()))?;
    Ok((format, usize::try_from(period).unwrap_or(0).max(1)))
}

fn failed<'a>(name: &'a str, what: &'a str) -> impl Fn(alsa::Error) -> CliError + 'a {
    move |error| CliError::SoundCard { device: name.to_owned(), reason: format!("failed to {what}: {error}") }
}
