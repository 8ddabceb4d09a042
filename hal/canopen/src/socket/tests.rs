use super::*;

fn told(id: u32, length: u8, data: [u8; 8]) -> Vec<Received> {
    let raw = RawFrame {
        id,
        length,
        data,
        ..RawFrame::default()
    };
    let mut all = Vec::new();
    raw.tell(&mut |received| all.push(received));
    all
}

fn troubles(id: u32, state: u8) -> Vec<Received> {
    told(libc::CAN_ERR_FLAG | id, 8, [0, state, 0, 0, 0, 0, 0, 0])
}

#[test]
fn frames_come_back_from_the_kernels_layout() {
    let frame = Frame::new(CanId::truncated(0x185), Payload::truncated(&[1, 2, 3]));
    let raw = RawFrame::of(&frame);
    assert_eq!(told(raw.id, raw.length, raw.data), [Received::Frame(frame)]);
    // A length that the kernel never gives is no reason to panic.
    assert_eq!(told(1, 200, [0; 8]).len(), 1);
}

#[test]
fn what_no_canopen_device_sends_is_foreign() {
    let foreign = [Received::ControllerEvent(ControllerEvent::Foreign)];
    assert_eq!(told(libc::CAN_EFF_FLAG | 0x185, 0, [0; 8]), foreign);
    assert_eq!(told(libc::CAN_RTR_FLAG | 0x185, 0, [0; 8]), foreign);
    assert_eq!(told(0x800, 0, [0; 8]), foreign);
}

#[test]
fn error_frames_say_what_the_controller_is_like() {
    let trouble = |trouble| [Received::ControllerEvent(trouble)];
    assert_eq!(troubles(0x040, 0), trouble(ControllerEvent::BusOff));
    assert_eq!(troubles(0x100, 0), trouble(ControllerEvent::Restarted));
    assert_eq!(
        troubles(0x004, 0x10),
        trouble(ControllerEvent::ErrorPassive)
    );
    assert_eq!(
        troubles(0x004, 0x20),
        trouble(ControllerEvent::ErrorPassive)
    );
    assert_eq!(troubles(0x004, 0x40), trouble(ControllerEvent::ErrorActive));
    assert_eq!(troubles(0x004, 0x01), trouble(ControllerEvent::Lost(1)));
    // On the way from passive to active there are warnings.
    for state in [0x04, 0x08, 0x0C] {
        assert_eq!(
            troubles(0x004, state),
            trouble(ControllerEvent::ErrorActive)
        );
    }
    assert_eq!(
        troubles(0x004, 0x14),
        trouble(ControllerEvent::ErrorPassive)
    );
    assert_eq!(troubles(0x200, 0), [], "counters");
}

#[derive(Debug)]
struct Never;

impl Clock for Never {
    fn now(&self) -> TimeNs {
        TimeNs(0)
    }

    fn wait(&mut self, _until: TimeNs) {}
}

#[test]
fn an_interface_that_is_not_there_is_named() {
    let error = SocketBus::open(&["nocan7".to_owned()], Never).unwrap_err();
    assert_eq!(
        error.to_string(),
        "nocan7: cannot be opened as a CAN interface"
    );
}
