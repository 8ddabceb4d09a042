use super::*;
use trocar_canopen::cia301::{AbortCode, Address};
use trocar_canopen::index;
use trocar_canopen::master::client::{read, read_number, write};

const NAME: Address = Address::new(0x1008, 0);

fn net() -> Net {
    network(&plan(1, 2 * MS))
}

#[test]
fn values_travel_whole_and_in_segments() {
    let mut net = net();
    let name = read(&mut net, 0, node(2), NAME).unwrap();
    assert_eq!(name.as_slice(), b"Trocar emulated drive");
    let label = b"insertion, the only axis that slides";
    write(&mut net, 0, node(2), index::LABEL, label).unwrap();
    let label_back = read(&mut net, 0, node(2), index::LABEL).unwrap();
    assert_eq!(label_back.as_slice(), label);
    write(&mut net, 0, node(2), index::HEARTBEAT, &[7, 1]).unwrap();
    assert_eq!(read_number(&mut net, 0, node(2), index::HEARTBEAT), Ok(263));
    // Nobody else was meant.
    assert_eq!(read_number(&mut net, 0, node(3), index::HEARTBEAT), Ok(0));
}

#[test]
fn a_refusal_carries_the_nodes_code() {
    let mut net = net();
    let error = write(&mut net, 0, node(0), index::STATUS, &[0, 0]).unwrap_err();
    let code = AbortCode::READ_ONLY;
    let (node, address) = (node(0), index::STATUS);
    assert_eq!(
        error,
        BringUpError::Refused {
            node,
            address,
            code
        }
    );
    assert_eq!(
        error.to_string(),
        "node 1: refuses 6041:00: 0x06010002, attempt to write a read-only object"
    );
    let long = write(&mut net, 0, node, index::LABEL, &[b'x'; 65]).unwrap_err();
    assert!(matches!(
        long,
        BringUpError::Refused {
            code: AbortCode::TOO_LONG,
            ..
        }
    ));
}

#[test]
fn no_answer_and_a_senseless_one_are_told_apart() {
    let mut net = net();
    net.tamper(Box::new(|_, _, f| {
        if f.id.raw() == 0x581 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    }));
    let before = net.now();
    let (node, address) = (node(0), NAME);
    let silent = read(&mut net, 0, node, address).map(|_| ());
    assert_eq!(silent, Err(BringUpError::NoAnswer { node, address }));
    assert!((500 * MS..520 * MS).contains(&net.now().since(before)));
    // An answer about another object.
    net.tamper(Box::new(|_, _, f| {
        if f.id.raw() == 0x581 {
            let mut data = f.data().to_vec();
            data[1] ^= 1;
            Tampering::Replace(frame(0x581, &data))
        } else {
            Tampering::Pass
        }
    }));
    let confused = read(&mut net, 0, node, address).map(|_| ());
    assert_eq!(confused, Err(BringUpError::Confused { node, address }));
    // A segment with the wrong toggle bit.
    net.tamper(Box::new(|_, _, f| {
        if f.id.raw() == 0x581 && f.data()[0] >> 5 == 0 {
            let mut data = f.data().to_vec();
            data[0] ^= 0x10;
            Tampering::Replace(frame(0x581, &data))
        } else {
            Tampering::Pass
        }
    }));
    let confused = read(&mut net, 0, node, address).map(|_| ());
    assert_eq!(confused, Err(BringUpError::Confused { node, address }));
    // And then all is well again.
    net.leave_alone();
    assert!(read(&mut net, 0, node, address).is_ok());
}

#[test]
fn a_node_that_sends_nothing_for_ever_is_confused() {
    let mut net = net();
    let (node, address) = (node(0), NAME);
    net.tamper(Box::new(|_, _, f| {
        if f.id.raw() == 0x581 && f.data()[0] >> 5 == 0 {
            // A segment without a byte, and not the last one.
            let toggle = f.data()[0] & 0x10;
            Tampering::Replace(frame(0x581, &[0x0E | toggle, 0, 0, 0, 0, 0, 0, 0]))
        } else {
            Tampering::Pass
        }
    }));
    let endless = read(&mut net, 0, node, address).map(|_| ());
    assert_eq!(endless, Err(BringUpError::Confused { node, address }));
}

#[test]
fn a_bus_that_is_off_ends_the_transfer() {
    let mut net = net();
    net.bus_off(0, true);
    let error = read(&mut net, 0, node(0), NAME).unwrap_err();
    assert_eq!(error.to_string(), "bus 0: bus-off or down");
}

/// A bus that takes nothing.
struct Full(Net);

impl Bus for Full {
    fn now(&self) -> TimeNs {
        self.0.now()
    }

    fn send(&mut self, _line: u8, _frames: &[Frame]) -> usize {
        0
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.0.receive(line, sink);
    }

    fn flush(&mut self, _line: u8) {}

    fn wait(&mut self, until: TimeNs) {
        self.0.wait(until);
    }
}

/// A bus without room is waited for and one that is down is told at once.
#[test]
fn full_bus_is_waited_for_and_a_down_one_is_an_error() {
    let mut bus = Full(net());
    let ask = |bus: &mut Full| read_number(bus, 0, node(0), index::STATUS);
    assert_eq!(ask(&mut bus), Err(BringUpError::CannotSend { line: 0 }));
    assert!(bus.now() >= TimeNs(500 * MS));
    let before = bus.now();
    bus.0.trouble(0, ControllerEvent::Down);
    assert_eq!(ask(&mut bus), Err(BringUpError::Off { line: 0 }));
    assert_eq!(bus.now(), before);
}
