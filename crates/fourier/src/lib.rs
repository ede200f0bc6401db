//! Plans of Fourier transforms in single and double precision.
//!
//! `rustfft` and `realfft` are generic over the type of the numbers, so every package that makes a plan with
//! them compiles all of their algorithms again. Here plans are made in functions that are not generic:
//! their code is compiled once, whatever else changes.
//!
//! ```
//! use flankwatch_fourier::Planned;
//!
//! let plan = f64::forward_plan(8);
//! let mut samples: Vec<f64> = (0..8).map(|n| (std::f64::consts::FRAC_PI_4 * f64::from(n)).cos()).collect();
//! let mut bins = plan.make_output_vec();
//! plan.process(&mut samples, &mut bins)?;
//! // A cosine of one period and amplitude 1: half of the 8 samples.
//! assert!((bins[1].re - 4.0).abs() < 1e-12 && bins[2].norm() < 1e-12);
//! # Ok::<(), realfft::FftError>(())
//! ```

use std::sync::Arc;

pub use realfft::num_complex::Complex;
pub use realfft::{ComplexToReal, RealToComplex};
pub use rustfft::{Fft, FftDirection};

use realfft::{FftNum, RealFftPlanner};
use rustfft::FftPlanner;

/// A type of numbers whose transforms can be planned. No plan divides by the length N.
pub trait Planned: FftNum {
    /// Plans Σ z·exp(∓2πikn/N) of N complex values.
    fn complex_plan(length: usize, direction: FftDirection) -> Arc<dyn Fft<Self>>;

    /// Plans bins 0 to ⌊N/2⌋ of Σ x·exp(−2πikn/N) of N real samples.
    fn forward_plan(length: usize) -> Arc<dyn RealToComplex<Self>>;

    /// Plans the N real samples that have the bins 0 to ⌊N/2⌋.
    fn inverse_plan(length: usize) -> Arc<dyn ComplexToReal<Self>>;
}

macro_rules! planned {
    ($($number:ty)*) => {$(
        impl Planned for $number {
            fn complex_plan(length: usize, direction: FftDirection) -> Arc<dyn Fft<Self>> {
                FftPlanner::new().plan_fft(length, direction)
            }

            fn forward_plan(length: usize) -> Arc<dyn RealToComplex<Self>> {
                RealFftPlanner::new().plan_fft_forward(length)
            }

            fn inverse_plan(length: usize) -> Arc<dyn ComplexToReal<Self>> {
                RealFftPlanner::new().plan_fft_inverse(length)
            }
        }
    )*};
}

planned!(f32 f64);
