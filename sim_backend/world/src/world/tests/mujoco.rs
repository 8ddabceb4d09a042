//! The drives and the chain against MuJoCo's model of them, by the numbers in
//! `tests/golden/mujoco_chain.toml`.
//!
//! `tests/scripts/mujoco_chain.py` says what that model is and wrote the file. With
//! `TROCAR_CHAIN_DUMP` set, the test writes what the script needs to that path first.

mod file;

use core::f64::consts::TAU;

use hal::config::Source;
use hal::psm::{ACTUATORS, COUPLING, DH, EFFORT_MAX, TIP_FROM_WRIST_YAW};
use hal::{ArmCommand, JOINT_COUNT, JointVector, Pose, TimeNs};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::plant::{AXIS_COUNT, AxisVector, Load, Plant, PlantConfig};
use crate::shipped;
use crate::world::chain::{Chain, Wrench};
use file::{File, Kind, Parameters, Run, Still, dump};

/// What the script compares with, too.
const WAY_TOLERANCE: f64 = 0.01;
const WAY_LEAST: f64 = 1e-3;
const TIP_TOLERANCE_M: f64 = 1e-4;
const TIP_TOLERANCE_RAD: f64 = 0.02;
const STATIC_TOLERANCE: f64 = 1e-8;

fn config() -> PlantConfig {
    shipped::world("needle-lift").plant
}

fn parameters() -> Parameters {
    let config = config();
    let actuators = |of: fn(&hal::psm::Actuator) -> f64| ACTUATORS.each_ref().map(of);
    let mut effort_max = EFFORT_MAX;
    effort_max[JOINT_COUNT] = config.jaw_effort_max_n_m;
    Parameters {
        dh: DH
            .iter()
            .map(|row| {
                let slides = if row.prismatic { 1.0 } else { 0.0 };
                [row.alpha, row.a, row.d, row.theta, slides]
            })
            .collect(),
        tip_from_wrist_yaw: TIP_FROM_WRIST_YAW,
        coupling: COUPLING,
        inertia: config.inertia,
        coulomb: config.coulomb,
        viscous: config.viscous,
        p: actuators(|drive| drive.p),
        d: actuators(|drive| drive.d),
        encoder_counts: actuators(|drive| drive.encoder_counts_per_turn),
        gear_ratio: actuators(|drive| drive.gear_ratio),
        current_max: actuators(|drive| drive.current_max_a),
        torque_constant: actuators(|drive| drive.torque_constant_n_m_a),
        effort_max,
    }
}

fn stills() -> Vec<Still> {
    [
        (
            [0.0, 0.0, 0.12, 0.0, 0.0, 0.0],
            [1.0, 2.0, 3.0, 0.1, 0.2, 0.3],
        ),
        (
            [0.3, -0.4, 0.14, 0.7, 0.5, -0.6],
            [1.0, -2.0, 0.5, 0.01, 0.03, -0.02],
        ),
        (
            [-1.2, 0.8, 0.06, 4.0, -1.3, 1.3],
            [-3.0, 0.5, 2.0, 0.02, 0.0, 0.05],
        ),
    ]
    .map(|(joints, wrench)| {
        let chain = Chain::new(&Pose::identity(), &JointVector::from(joints));
        Still {
            joints,
            wrench,
            efforts: chain.joint_efforts(&wrench_of(&wrench)).into(),
            tip: numbers(&chain.tip),
        }
    })
    .to_vec()
}

/// The runs as they are asked for, without results.
fn wanted() -> [Run; 3] {
    let blank = |kind, milliseconds, sample_ms, start| Run {
        kind,
        milliseconds,
        sample_ms,
        start,
        amplitude: Vec::new(),
        frequency_hz: Vec::new(),
        target: Vec::new(),
        joints: Vec::new(),
        tips: Vec::new(),
    };
    let torque = [0.2, -0.1, 0.10, 0.3, -0.2, 0.1, 0.5];
    let force = [-0.3, 0.2, 0.14, -0.5, 0.3, -0.4, 0.4];
    let drive = [0.1, 0.1, 0.12, 0.2, 0.1, -0.2, 0.5];
    [
        Run {
            amplitude: vec![1.0, -0.9, 3.0, 0.03, 0.02, -0.02, 0.006],
            frequency_hz: vec![1.3, 1.7, 1.1, 3.3, 3.9, 3.5, 2.6],
            ..blank(Kind::Torque, 1000, 50, torque)
        },
        Run {
            amplitude: vec![1.2, -1.5, 2.0, 0.006, -0.008, 0.008],
            frequency_hz: vec![2.3, 2.7, 1.6, 3.3, 3.9, 3.6],
            ..blank(Kind::Force, 1000, 50, force)
        },
        Run {
            target: vec![0.14, 0.06, 0.13, 0.5, -0.1, 0.1, 0.3],
            ..blank(Kind::Drive, 600, 20, drive)
        },
    ]
}

/// What our drives and chain do in `run`.
fn simulated(mut run: Run) -> Run {
    let (joints, jaw) = split(&run.start);
    let mut plant = Plant::new(&config(), &joints, jaw);
    let aim: AxisVector = run.target.clone().try_into().unwrap_or(run.start);
    let (position, jaw_position) = split(&aim);
    plant.command(&ArmCommand {
        stamp: TimeNs(0),
        position,
        velocity: JointVector::zeros(),
        acceleration: JointVector::zeros(),
        jaw_position,
        jaw_velocity: 0.0,
        enabled: run.kind == Kind::Drive,
    });
    for millisecond in 0..run.milliseconds {
        let time_s = 1e-3 * f64::from(millisecond);
        let wave =
            |index: usize| run.amplitude[index] * (TAU * run.frequency_hz[index] * time_s).cos();
        let mut load = Load::default();
        match run.kind {
            Kind::Torque => load.efforts = core::array::from_fn(wave),
            Kind::Force => {
                let efforts =
                    chain_of(&plant).joint_efforts(&wrench_of(&core::array::from_fn(wave)));
                load.efforts[..JOINT_COUNT].copy_from_slice(efforts.as_slice());
            }
            Kind::Drive => {}
        }
        plant.step(&load);
        if (millisecond + 1).is_multiple_of(run.sample_ms) {
            run.joints.push(plant.joints());
            run.tips.push(numbers(&chain_of(&plant).tip));
        }
    }
    run
}

fn split(axes: &AxisVector) -> (JointVector, f64) {
    (
        JointVector::from_column_slice(&axes[..JOINT_COUNT]),
        axes[JOINT_COUNT],
    )
}

fn chain_of(plant: &Plant) -> Chain {
    Chain::new(&Pose::identity(), &split(&plant.joints()).0)
}

fn wrench_of(numbers: &[f64; 6]) -> Wrench {
    Wrench {
        force: Vector3::from_column_slice(&numbers[..3]),
        moment: Vector3::from_column_slice(&numbers[3..]),
    }
}

fn numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

fn rotation(tip: &[f64; 7]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(tip[6], tip[3], tip[4], tip[5]))
}

fn ours() -> File {
    File {
        parameters: parameters(),
        still: stills(),
        run: wanted().map(simulated).to_vec(),
    }
}

/// MuJoCo's side. If the parameters are not ours any more the script must be run again.
fn golden() -> File {
    let path = "tests/golden/mujoco_chain.toml";
    let text = include_str!("../../../../../tests/golden/mujoco_chain.toml");
    Source::embedded(path, text).parse().unwrap()
}

#[test]
fn plant_and_chain_move_as_in_mujoco() {
    let ours = ours();
    if let Some(path) = std::env::var_os("TROCAR_CHAIN_DUMP") {
        std::fs::write(path, dump(&ours)).unwrap();
    }
    let golden = golden();
    assert_eq!(golden.parameters, ours.parameters);
    assert_eq!(golden.run.len(), ours.run.len());
    for (ours, theirs) in ours.run.iter().zip(&golden.run) {
        let asked = |run: &Run| Run {
            joints: Vec::new(),
            tips: Vec::new(),
            ..run.clone()
        };
        assert_eq!(asked(ours), asked(theirs));
        assert_eq!(ours.joints.len(), theirs.joints.len());
        for axis in 0..AXIS_COUNT {
            let (mut least, mut most, mut apart) = (ours.start[axis], ours.start[axis], 0.0_f64);
            for (ours, theirs) in ours.joints.iter().zip(&theirs.joints) {
                least = least.min(theirs[axis]);
                most = most.max(theirs[axis]);
                apart = apart.max((ours[axis] - theirs[axis]).abs());
            }
            let way = (most - least).max(WAY_LEAST);
            let kind = ours.kind;
            assert!(
                apart <= WAY_TOLERANCE * way,
                "{kind:?}, axis {axis}: {apart} of {way}"
            );
            assert!(
                way > 5.0 * WAY_LEAST || (kind == Kind::Force && axis == JOINT_COUNT),
                "{kind:?}: axis {axis} hardly moves"
            );
        }
        for (ours, theirs) in ours.tips.iter().zip(&theirs.tips) {
            let place = |tip: &[f64; 7]| Vector3::from_column_slice(&tip[..3]);
            assert!((place(ours) - place(theirs)).norm() <= TIP_TOLERANCE_M);
            assert!(rotation(ours).angle_to(&rotation(theirs)) <= TIP_TOLERANCE_RAD);
        }
    }
}

#[test]
fn loads_of_a_force_at_the_tip_are_those_of_mujoco() {
    let (ours, golden) = (stills(), golden().still);
    assert_eq!(ours.len(), golden.len());
    for (ours, theirs) in ours.iter().zip(&golden) {
        assert_eq!((ours.joints, ours.wrench), (theirs.joints, theirs.wrench));
        for (ours, theirs) in [
            (&ours.efforts[..], &theirs.efforts[..]),
            (&ours.tip[..], &theirs.tip[..]),
        ] {
            for (ours, theirs) in ours.iter().zip(theirs) {
                assert!((ours - theirs).abs() <= STATIC_TOLERANCE, "{ours} {theirs}");
            }
        }
    }
}
