//! Smooth point-to-point motion of the tip, whose end may drift while it is under way.

use hal::{Pose, TimeNs};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Tip pose and jaw angle, in the scene frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    /// The control point: on the wrist-yaw axis, z along the closed fingers, x along their hinge.
    pub(crate) tip_in_scene: Pose,
    /// Angle between the fingers, rad; one below that of contact commands a squeeze.
    pub(crate) jaw: f64,
}

impl Placement {
    /// The same place with the jaw at `jaw`.
    pub(crate) fn with_jaw(self, jaw: f64) -> Self {
        Self { jaw, ..self }
    }

    /// The same jaw angle at another place.
    pub(crate) fn with_tip(self, tip_in_scene: Pose) -> Self {
        Self {
            tip_in_scene,
            ..self
        }
    }
}

/// How fast a motion may be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Peak speed of the tip, m/s.
    pub(crate) speed_m_s: f64,
    /// Peak rate of the jaw, rad/s.
    pub(crate) jaw_rate_rad_s: f64,
    /// Shortest time that a motion takes, s.
    pub(crate) duration_s_min: f64,
}

/// Peak rate of turning, rad/s.
const TURN_RATE_RAD_S: f64 = 1.2;

/// Peak speed of [`blend`] over its mean speed.
const BLEND_PEAK: f64 = 1.875;

/// One motion from rest to rest along a minimum-jerk profile, with an optional sideways bow. Place,
/// rotation (shortest turn) and jaw share one clock. It lasts as long as the slowest of them needs
/// at its peak rate, and no longer when its end drifts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    from: Placement,
    to: Placement,
    /// Greatest distance from the straight way, reached half way, scene frame, m.
    bow_m: Vector3<f64>,
    /// Instead of the straight way from `from` to `to`; then there is no bow, and the jaw rests.
    swing: Option<Swing>,
    began: TimeNs,
    duration_s: f64,
    /// How long after its end it counts as over, s.
    put_off_s: f64,
}

/// A turn about a fixed upright axis instead of the straight way.
#[derive(Clone, Copy, Debug)]
struct Swing {
    centre: Point3<f64>,
    angle_rad: f64,
}

impl Motion {
    /// A motion that starts at `began` and keeps to `pace`.
    pub(crate) fn new(
        from: Placement,
        to: Placement,
        bow_m: Vector3<f64>,
        began: TimeNs,
        pace: Pace,
    ) -> Self {
        let start = from.tip_in_scene.translation.vector;
        // A bow goes out and back; 2.6 covers the peak of its own speed on top of that of the
        // straight way.
        let way_m = (to.tip_in_scene.translation.vector - start).norm() + 2.6 * bow_m.norm();
        let turn_rad = from
            .tip_in_scene
            .rotation
            .angle_to(&to.tip_in_scene.rotation);
        let duration_s = [
            BLEND_PEAK * way_m / pace.speed_m_s,
            BLEND_PEAK * turn_rad / TURN_RATE_RAD_S,
            BLEND_PEAK * (to.jaw - from.jaw).abs() / pace.jaw_rate_rad_s,
        ]
        .into_iter()
        .fold(pace.duration_s_min, f64::max);
        Self {
            from,
            to,
            bow_m,
            swing: None,
            began,
            duration_s,
            put_off_s: 0.0,
        }
    }

    /// A motion that turns the tip by `angle_rad` about the vertical through `centre`.
    pub(crate) fn swing(
        from: Placement,
        centre: Point3<f64>,
        angle_rad: f64,
        began: TimeNs,
        pace: Pace,
    ) -> Self {
        let swing = Swing { centre, angle_rad };
        let to = Placement {
            tip_in_scene: swing.turned(&from.tip_in_scene, 1.0),
            ..from
        };
        let lever_m = (from.tip_in_scene.translation.vector - centre.coords).norm();
        let way_m = lever_m * angle_rad.abs();
        let duration_s = (BLEND_PEAK * way_m / pace.speed_m_s)
            .max(BLEND_PEAK * angle_rad.abs() / TURN_RATE_RAD_S)
            .max(pace.duration_s_min);
        Self {
            from,
            to,
            bow_m: Vector3::zeros(),
            swing: Some(swing),
            began,
            duration_s,
            put_off_s: 0.0,
        }
    }

    /// No motion: stays at `placement` and counts as arrived after `duration_s`.
    pub(crate) fn rest(placement: Placement, began: TimeNs, duration_s: f64) -> Self {
        Self {
            from: placement,
            to: placement,
            bow_m: Vector3::zeros(),
            swing: None,
            began,
            duration_s: duration_s.max(1e-3),
            put_off_s: 0.0,
        }
    }

    /// Where the motion ends.
    pub(crate) fn end(&self) -> &Placement {
        &self.to
    }

    /// Moves the end towards `wanted`, by at most `step_m` and `step_rad`, so that the path bends
    /// instead of jumping. Called once a step. The path moves by the blend `s` (0 to 1) of what the
    /// end moves by.
    pub(crate) fn drift_end(&mut self, wanted: &Pose, step_m: f64, step_rad: f64) {
        let end = &mut self.to.tip_in_scene;
        let gap_m = wanted.translation.vector - end.translation.vector;
        let share = if gap_m.norm() > step_m {
            step_m / gap_m.norm()
        } else {
            1.0
        };
        end.translation = Translation3::from(end.translation.vector + gap_m * share);
        let turn_rad = end.rotation.angle_to(&wanted.rotation);
        let share = if turn_rad > step_rad {
            step_rad / turn_rad
        } else {
            1.0
        };
        end.rotation = end
            .rotation
            .try_slerp(&wanted.rotation, share, 1e-12)
            .unwrap_or(end.rotation);
    }

    /// Where the tip should be at `now`. With `s` the blend of the elapsed share, straight ways are
    /// at `from + (to - from) s + bow (4 s (1 - s))²`: the bow and its slope vanish at both ends.
    /// Before it began it is at `from`, after its end at `to`.
    pub(crate) fn at(&self, now: TimeNs) -> Placement {
        let share = (self.elapsed_s(now) / self.duration_s).clamp(0.0, 1.0);
        let s = blend(share);
        if let Some(swing) = self.swing {
            return Placement {
                tip_in_scene: swing.turned(&self.from.tip_in_scene, s),
                jaw: self.from.jaw,
            };
        }
        let from = self.from.tip_in_scene;
        let to = self.to.tip_in_scene;
        let bow = (4.0 * s * (1.0 - s)).powi(2);
        let position = from.translation.vector.lerp(&to.translation.vector, s) + self.bow_m * bow;
        let rotation = from
            .rotation
            .try_slerp(&to.rotation, s, 1e-12)
            .unwrap_or(to.rotation);
        Placement {
            tip_in_scene: Pose::from_parts(Translation3::from(position), rotation),
            jaw: self.from.jaw + (self.to.jaw - self.from.jaw) * s,
        }
    }

    /// Seconds since the motion ought to have ended; negative while it is under way. A motion never
    /// ends by itself: its part asks for this and decides.
    pub(crate) fn overdue_s(&self, now: TimeNs) -> f64 {
        self.elapsed_s(now) - self.duration_s - self.put_off_s
    }

    /// It ought to have ended this much later, s; the way stays as it is.
    pub(crate) fn put_off(&mut self, by_s: f64) {
        self.put_off_s += by_s;
    }

    fn elapsed_s(&self, now: TimeNs) -> f64 {
        TimeNs(now.since(self.began)).seconds()
    }
}

impl Swing {
    /// `pose` after `share` of the turn.
    fn turned(&self, pose: &Pose, share: f64) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.angle_rad * share);
        let about = Translation3::from(self.centre.coords);
        about * turn * about.inverse() * pose
    }
}

/// Minimum-jerk blend from 0 to 1: velocity and acceleration vanish at both ends (Flash and Hogan,
/// 1985).
fn blend(share: f64) -> f64 {
    share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placement(x: f64, jaw: f64) -> Placement {
        Placement {
            tip_in_scene: Pose::translation(x, 0.0, 0.05),
            jaw,
        }
    }

    const PACE: Pace = Pace {
        speed_m_s: 0.05,
        jaw_rate_rad_s: 3.0,
        duration_s_min: 0.2,
    };

    #[test]
    fn speed_stays_under_the_pace_with_a_bow() {
        let bow_m = Vector3::new(0.0, 0.004, 0.0);
        let motion = Motion::new(
            placement(0.0, 0.0),
            placement(0.03, 0.6),
            bow_m,
            TimeNs(0),
            PACE,
        );
        let mut peak: f64 = 0.0;
        for tick in 0..3000 {
            let here = motion
                .at(TimeNs::from_tick(tick))
                .tip_in_scene
                .translation
                .vector;
            let next = motion
                .at(TimeNs::from_tick(tick + 1))
                .tip_in_scene
                .translation
                .vector;
            peak = peak.max((next - here).norm() * 1000.0);
        }
        assert!(
            peak < PACE.speed_m_s && peak > 0.6 * PACE.speed_m_s,
            "{peak}"
        );
    }

    #[test]
    fn swing_keeps_its_distance_and_ends_where_it_says() {
        let centre = Point3::new(0.0, 0.02, 0.01);
        let motion = Motion::swing(placement(0.0, 0.1), centre, 1.2, TimeNs(0), PACE);
        let start = motion.at(TimeNs(0)).tip_in_scene;
        let mut before = start;
        for tick in 0..3000 {
            let here = motion.at(TimeNs::from_tick(tick)).tip_in_scene;
            let lever = here.translation.vector - centre.coords;
            assert!((lever.xy().norm() - 0.02).abs() < 1e-12 && (lever.z - 0.04).abs() < 1e-12);
            let step_m = (here.translation.vector - before.translation.vector).norm();
            assert!(step_m * 1000.0 < PACE.speed_m_s);
            before = here;
        }
        let end = motion.end().tip_in_scene;
        assert!((end.translation.vector - before.translation.vector).norm() < 1e-12);
        assert!((end.rotation.angle_to(&start.rotation) - 1.2).abs() < 1e-9);
    }

    #[test]
    fn drifting_end_is_reached_without_a_jump() {
        let mut motion = Motion::new(
            placement(0.0, 0.0),
            placement(0.03, 0.0),
            Vector3::zeros(),
            TimeNs(0),
            PACE,
        );
        let wanted = Pose::translation(0.03, 0.01, 0.05);
        let mut last = motion.at(TimeNs(0)).tip_in_scene.translation.vector;
        for step in 1..60 {
            motion.drift_end(&wanted, 0.0008, 0.04);
            let here = motion
                .at(TimeNs::from_tick(40 * step))
                .tip_in_scene
                .translation
                .vector;
            assert!(
                (here - last).norm() < 0.04 * (PACE.speed_m_s + 0.02),
                "jump of {}",
                (here - last).norm()
            );
            last = here;
        }
        assert!((last - wanted.translation.vector).norm() < 1e-9);
    }
}
