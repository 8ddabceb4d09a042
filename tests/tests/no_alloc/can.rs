//! The CAN arm between two SYNCs: reading, judging, and sending.

use std::error::Error;

use hal::{Arm as _, ArmCommand, JointVector, SafeTail};
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::master::config::CanConfig;
use trocar_canopen::master::{Bus as _, CanArm, Offline};
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{IdealMotor, Network};

use trocar::rt::thread_allocations;

type Net = Network<IdealMotor>;

fn arm() -> Result<(CanArm<Net>, u64), Box<dyn Error>> {
    let config = CanConfig::load(&CanConfig::shipped())?;
    let plan = config.arms[0].plan;
    let mut net = Net::new(plan.lines, plan.bit_rate, 64);
    for axis in &plan.axes {
        let node = Node::new(axis.node, &AxisConfig::of(axis, 0));
        net.add(axis.line, node, IdealMotor::default());
    }
    let scanned = Offline::new(net, &plan)?.scan()?;
    let arm = scanned.check_identity()?.map()?.home()?.enable()?;
    Ok((arm, plan.cycle_ns))
}

#[test]
fn can_arm_allocates_nothing_in_its_cycle() -> Result<(), Box<dyn Error>> {
    let (mut arm, cycle_ns) = arm()?;
    let mut now = arm.bus_mut().now();
    let mut faulted = 0;
    for n in 0..400_u32 {
        now = now.plus_ns(cycle_ns);
        // The buses in memory are not what is looked at.
        arm.bus_mut().wait(now);
        if n == 300 {
            let node = trocar_canopen::NodeId::new(3).ok_or("a node")?;
            arm.bus_mut().poke(node, |now, drive, out| {
                drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
            });
        }
        let command = ArmCommand {
            stamp: now,
            position: JointVector::repeat(f64::from(n) * 1e-5),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: 0.0,
            jaw_velocity: 0.0,
            enabled: !(200..=250).contains(&n),
        };
        let tail = SafeTail::hold(&command);
        let before = thread_allocations();
        let measured = arm.read(now);
        // In some cycles the controller says nothing.
        let written = if n % 7 == 0 {
            Ok(())
        } else {
            arm.write(&command, &tail)
        };
        arm.send_before(now.plus_ns(cycle_ns));
        assert_eq!(thread_allocations(), before, "cycle {n}");
        faulted += u32::from(measured.is_err() && written.is_err());
    }
    // Three hundred cycles without, and then with a fault.
    assert!((50..=99).contains(&faulted), "{faulted}");
    Ok(())
}
