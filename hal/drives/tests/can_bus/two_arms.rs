//! Two arms on one bus: while the second is brought up the first waits, and goes on hearing.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use super::{Drives, MS, Real, alone, frame, node, plan, socket};
use trocar_canopen::master::{
    ArmPlan, BringUpError, Bus as _, ControllerEvent, Homed, Offline, Permission, Received,
    enable_together,
};
use trocar_canopen::socket::SocketBus;
use trocar_canopen::{CanId, NodeId};
use trocar_drives::dictionary::table::PRODUCT_CODE;

type Ready = Homed<SocketBus<Real>>;

/// The plans of two arms whose nodes are 1 to 7 and 11 to 17.
fn plans() -> [ArmPlan; 2] {
    let first = plan((0, PRODUCT_CODE), 20);
    let mut second = first;
    second.sync_id = CanId::new(0x100).unwrap();
    second.master = NodeId::new(126).unwrap();
    for (axis, number) in second.axes.iter_mut().zip(10..) {
        axis.node = node(number);
    }
    [first, second]
}

fn homed(plan: &ArmPlan) -> Ready {
    let scanned = Offline::new(socket("vcan0"), plan).unwrap().scan().unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    mapped.home().unwrap()
}

/// Brings up the second arm while the first listens, and what the first heard; then another node
/// sends `said`.
fn brought_up(said: Option<(u16, &[u8])>) -> (Result<(), BringUpError>, [Ready; 2]) {
    let [first, second] = plans();
    let mut waiting = homed(&first);
    let done = AtomicBool::new(false);
    let (heard, last) = thread::scope(|scope| {
        let listener = scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                waiting.listen()?;
                let later = waiting.bus_mut().now().plus_ns(MS);
                waiting.bus_mut().wait(later);
            }
            waiting.listen()
        });
        let last = homed(&second);
        if let Some((id, data)) = said {
            let mut stranger = socket("vcan0");
            assert_eq!(stranger.send(0, &[frame(id, data)]), 1);
        }
        done.store(true, Ordering::Relaxed);
        (listener.join().unwrap(), last)
    });
    (heard, [waiting, last])
}

/// An arm that listens while another comes up misses nothing and both are enabled.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn waiting_arm_misses_no_frame_and_both_are_enabled() {
    let _turn = alone();
    let drives = Drives::of_arms(&[0, 10]);
    let (heard, mut arms) = brought_up(None);
    heard.unwrap();
    let mut lost = 0;
    arms[0].bus_mut().receive(0, &mut |received| {
        lost += u32::from(matches!(
            received,
            Received::ControllerEvent(ControllerEvent::Lost(_))
        ));
    });
    assert_eq!(lost, 0);
    let mut arms = enable_together(arms.into(), &mut || Permission::Granted).unwrap();
    for arm in &mut arms {
        arm.shut_down();
    }
    let _places = drives.finish();
}

/// A drive that fails or restarts while another arm comes up is heard.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn drive_fault_is_noticed_while_another_arm_comes_up() {
    let _turn = alone();
    let emergency: &[u8] = &[0x10, 0x23, 0x03, 0, 0, 0, 0, 0];
    for (id, data, text) in [
        (0x083, emergency, "2310h"),
        (0x703, &[0][..], "booted up again"),
    ] {
        let drives = Drives::of_arms(&[0, 10]);
        let (heard, arms) = brought_up(Some((id, data)));
        let error = heard.unwrap_err().to_string();
        assert!(error.contains("node 3") && error.contains(text), "{error}");
        drop(arms);
        let _places = drives.finish();
    }
}
