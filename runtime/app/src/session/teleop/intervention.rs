//! An operator beside a policy: takes over from it in mid-run, and hands back.

use std::sync::Arc;

use hal::{ArmObservation, Chunk, PerArm, Pose, TICK_S, TipTarget};
use rtrb::Producer;

use super::{CHUNK_TICKS, Driver, Hands, HandsNotice, TIME_FACTOR, Teleop};
use crate::session::SessionError;

/// Time between two answers of the hands, s.
#[expect(clippy::cast_precision_loss, reason = "a handful of ticks")]
const ANSWER_S: f64 = CHUNK_TICKS as f64 * TICK_S;

/// What the control thread gets of teleoperation. Plain data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TeleopCommand {
    /// Who drives.
    pub(crate) driver: Driver,
    /// What the hands want; of no account while the policy drives.
    pub(crate) chunks: PerArm<Chunk>,
}

/// The hands beside a policy.
///
/// The control thread hears of them while they drive, and once when the policy does again.
pub(crate) struct Intervention {
    teleop: Teleop,
    hands: Arc<Hands>,
    to: Producer<TeleopCommand>,
    /// Who drives, as the control thread was last sent.
    said: Driver,
    /// Whether the control thread has heard who drives since the episode's start: before it, the
    /// hands hold the arms, which is nobody's driving.
    begun: bool,
    /// What the episode may still take longer because of the hands, s.
    left_s: f64,
    notices: Vec<String>,
}

impl Intervention {
    /// Of arms that see the view at `rcms_from_view`, whose policy drives, unless the episode
    /// `waits` for its start: till then the hands hold the arms. An episode of `limit_s` may take
    /// longer by what the hands drive, up to a factor of [`TIME_FACTOR`].
    pub(crate) fn new(
        rcms_from_view: &[Pose],
        hands: &Arc<Hands>,
        (waits, limit_s): (bool, f64),
        to: Producer<TeleopCommand>,
    ) -> Self {
        let teleop = Teleop::new(rcms_from_view, Arc::clone(hands), waits);
        hands.beside_policy();
        Self {
            teleop,
            hands: Arc::clone(hands),
            to,
            said: Driver::Policy,
            begun: false,
            left_s: (TIME_FACTOR - 1.0) * limit_s,
            notices: Vec::new(),
        }
    }

    /// Releases every clutch: it has to be taken anew.
    pub(crate) fn release(&self) {
        self.teleop.release();
    }

    /// Looks at the hands, with the arms measured as `seen`, and tells the control thread what they
    /// want. Gives the time that the episode may take longer since they drive, s.
    ///
    /// # Errors
    /// Those of [`Teleop::answer`].
    pub(crate) fn answer(&mut self, seen: &PerArm<ArmObservation>) -> Result<f64, SessionError> {
        let chunks = self.teleop.answer(seen)?;
        let begun = !self.hands.waits();
        let moves = self.teleop.moves();
        let driver = self.hands.driver(moves).unwrap_or(Driver::Policy);
        let more_s = match driver {
            Driver::Policy => {
                self.teleop.stand_by();
                0.0
            }
            Driver::Operator => self.drove(),
        };
        let changed = driver != self.said;
        // A full queue means that the control thread is late: it hears it the next time.
        let sent = (changed || driver == Driver::Operator)
            && self.to.push(TeleopCommand { driver, chunks }).is_ok();
        if changed && sent {
            self.said = driver;
            self.notices.push(HandsNotice::Driver(driver).to_string());
        }
        let driven = self.teleop.asked().map(|(driver, _)| driver);
        self.begun = begun && (self.begun || (self.said == driver && driven == Some(driver)));
        Ok(more_s)
    }

    /// The hands have driven since the last answer; how much longer the episode may take for it, s.
    fn drove(&mut self) -> f64 {
        if !self.hands.drove_s(ANSWER_S) {
            return 0.0;
        }
        let more_s = ANSWER_S.min(self.left_s);
        self.left_s -= more_s;
        more_s
    }

    /// Who asked the arms last, as the control thread has it, and where they were asked to be; none
    /// before the first command since the episode's start.
    pub(crate) fn asked(&self) -> Option<(Driver, PerArm<TipTarget>)> {
        self.teleop.asked().filter(|_| self.begun)
    }

    /// What the log is to say, since the last call.
    pub(crate) fn take_notices(&mut self) -> Vec<String> {
        let mut notices = self.teleop.take_notices();
        notices.append(&mut self.notices);
        notices
    }
}
