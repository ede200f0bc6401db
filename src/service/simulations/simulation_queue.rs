//! The order of simulations. Each uses all threads for simulations, so they run one after the other; a
//! library that an asset waits for comes before one that only refines its estimates.

use std::collections::BTreeSet;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use super::status::SimulationStage;
use crate::service::error::ServiceError;
use crate::service::workers;

/// A priority lock on the threads for simulations: the earlier stage first, and within a stage in the order
/// of arrival.
#[derive(Debug)]
pub(super) struct SimulationQueue {
    threads: rayon::ThreadPool,
    queue: Mutex<Queue>,
    freed: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    is_taken: bool,
    tickets: u64,
    waiting: BTreeSet<(SimulationStage, u64)>,
}

/// The right to simulate, until it is dropped.
pub(super) struct SimulationPermit<'a>(&'a SimulationQueue);

impl SimulationQueue {
    /// Creates the threads.
    ///
    /// # Errors
    /// The system does not give that many threads.
    pub(super) fn new(threads: usize) -> Result<Self, ServiceError> {
        let threads = workers::threads(threads, "simulation")?;
        Ok(Self { threads, queue: Mutex::default(), freed: Condvar::new() })
    }

    /// Number of threads.
    pub(super) fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Waits for the permit of a stage.
    pub(super) fn wait(&self, stage: SimulationStage) -> SimulationPermit<'_> {
        let mut queue = self.queue();
        let mine = (stage, queue.tickets);
        queue.tickets += 1;
        queue.waiting.insert(mine);
        let mut queue = self
            .freed
            .wait_while(queue, |queue| queue.is_taken || queue.waiting.first() != Some(&mine))
            .unwrap_or_else(PoisonError::into_inner);
        queue.waiting.remove(&mine);
        queue.is_taken = true;
        SimulationPermit(self)
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SimulationPermit<'_> {
    /// Runs `simulate` on the threads for simulations.
    pub(super) fn run<T: Send>(&self, simulate: impl FnOnce() -> T + Send) -> T {
        self.0.threads.install(simulate)
    }
}

impl Drop for SimulationPermit<'_> {
    fn drop(&mut self) {
        self.0.queue().is_taken = false;
        self.0.freed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn earlier_stages_come_first() {
        use SimulationStage::{FirstMembers, Library, Members};
        let simulations = SimulationQueue::new(1).unwrap();
        let order = Mutex::new(Vec::new());
        let held = simulations.wait(Members);
        std::thread::scope(|scope| {
            for (count, stage) in [Members, FirstMembers, Members, Library, Library].into_iter().enumerate() {
                let (simulations, order) = (&simulations, &order);
                scope.spawn(move || {
                    let _permit = simulations.wait(stage);
                    order.lock().unwrap().push((stage, count));
                });
                // They start to wait in this order.
                while simulations.queue().waiting.len() <= count {
                    std::thread::yield_now();
                }
            }
            drop(held);
        });
        let expected = [(Library, 3), (Library, 4), (FirstMembers, 1), (Members, 0), (Members, 2)];
        assert_eq!(*order.lock().unwrap(), expected);
    }

    #[test]
    fn a_simulation_uses_its_threads_alone() {
        let simulations = SimulationQueue::new(3).unwrap();
        let permit = simulations.wait(SimulationStage::Library);
        let names: BTreeSet<String> = permit.run(|| {
            let name = |_| std::thread::current().name().unwrap_or_default().to_owned();
            assert_eq!(rayon::current_num_threads(), 3);
            (0..1000).into_par_iter().map(name).collect()
        });
        assert!(names.len() <= 3 && names.iter().all(|name| name.starts_with("simulation-")), "{names:?}");
    }
}
