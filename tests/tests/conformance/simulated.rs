//! The arm of a simulated episode.

use hal::{Arm, TimeNs};
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::TaskConfig;

use crate::rig::{Nature, Rig};

/// The first arm of needle lift.
pub(crate) struct Simulated {
    simulation: Simulation,
    tick: u64,
}

/// A fresh episode, the same each time.
pub(crate) fn make() -> Box<dyn Rig> {
    let task = TaskConfig::built_in("needle-lift").unwrap();
    let simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
    Box::new(Simulated {
        simulation,
        tick: 0,
    })
}

impl Rig for Simulated {
    fn arm(&mut self) -> &mut dyn Arm {
        &mut self.simulation
    }

    fn now(&self) -> TimeNs {
        TimeNs::from_tick(self.tick)
    }

    fn pass(&mut self) {
        self.simulation.step();
        self.tick += 1;
    }

    fn nature(&self) -> Nature {
        Nature {
            period_ns: hal::TICK_NS,
            age_max_ns: 0,
            // The shipped gains bring yaw in with 50 ms.
            settle_ns: 200_000_000,
            bridged: 0,
        }
    }
}
