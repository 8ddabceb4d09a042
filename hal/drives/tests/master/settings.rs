//! What drives have stored, and what of it bring-up leaves, changes or refuses.

use super::*;
use trocar_canopen::cia301::Address;
use trocar_canopen::index;
use trocar_canopen::master::client::{read, write};

/// Bring-up up to where all is set, of drives of which node 3 has stored `stored`.
fn mapped(stored: &[(Address, &[u8])]) -> Net {
    let plan = plan(1, 2 * MS);
    let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
    let mut scanned = scanned.unwrap();
    let net = scanned.bus_mut();
    for (address, data) in stored {
        write(net, 0, node(2), *address, data).unwrap();
    }
    write(net, 0, node(2), index::STORE, b"save").unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    let mut homed = mapped.home().unwrap();
    core::mem::replace(homed.bus_mut(), network(&plan))
}

#[test]
fn limits_and_stops_that_a_drive_has_stored_are_replaced() {
    // Object, what is stored, what it is after bring-up.
    let cases: [(Address, &[u8], &[u8]); 14] = [
        // A quick stop and a ramp ten times gentler: 2.2 units/s in 20 ms and in 100 ms are wanted.
        (
            index::QUICK_STOP_DECELERATION,
            &2_000_000_u32.to_le_bytes(),
            &11_000_000_u32.to_le_bytes(),
        ),
        (
            index::DECELERATION,
            &1_000_000_u32.to_le_bytes(),
            &2_200_000_u32.to_le_bytes(),
        ),
        // No stop at all, or one that holds on for good.
        (index::ABORT_OPTION, &[0, 0], &[3, 0]),
        (index::QUICK_STOP_OPTION, &[6, 0], &[2, 0]),
        (index::SHUTDOWN_OPTION, &[0, 0], &[1, 0]),
        (index::DISABLE_OPTION, &[0, 0], &[1, 0]),
        (index::FAULT_OPTION, &[0, 0], &[2, 0]),
        // Twice the speed, three times the torque, a window that is left unnoticed for long.
        (
            index::SPEED_MAX,
            &400_000_u32.to_le_bytes(),
            &220_000_u32.to_le_bytes(),
        ),
        // The same in turns of the motor a minute, of 10 000 counts each.
        (
            index::MOTOR_SPEED_MAX,
            &2400_u32.to_le_bytes(),
            &1320_u32.to_le_bytes(),
        ),
        (index::TORQUE_MAX, &[0xB8, 0x0B], &[0xE8, 0x03]),
        (index::FOLLOWING_TIME, &[0xE8, 0x03], &[10, 0]),
        // A part of the range only.
        (
            index::LIMIT_MAX,
            &(-400_000_i32).to_le_bytes(),
            &500_000_i32.to_le_bytes(),
        ),
        // Emergencies where nobody listens: 183h.
        (
            index::EMERGENCY_COB,
            &(0x8000_0083_u32).to_le_bytes(),
            &0x83_u32.to_le_bytes(),
        ),
        // Or a tenth of a second after the one before.
        (index::EMERGENCY_INHIBIT, &[0xE8, 0x03], &[0, 0]),
    ];
    let stored = cases.map(|(address, stored, _)| (address, stored));
    let mut net = mapped(&stored);
    for (address, _, wanted) in cases {
        let found = read(&mut net, 0, node(2), address).unwrap();
        assert_eq!(found.as_slice(), wanted, "{address}");
    }
}

#[test]
fn a_drive_that_is_stricter_than_it_must_be_stays_so() {
    // These drives have half the window, and a range without a margin.
    let mut net = mapped(&[(index::FOLLOWING_WINDOW, &4_000_u32.to_le_bytes())]);
    let window = read(&mut net, 0, node(2), index::FOLLOWING_WINDOW).unwrap();
    assert_eq!(window.as_slice(), 4_000_u32.to_le_bytes());
    let low = read(&mut net, 0, node(2), index::LIMIT_MIN).unwrap();
    assert_eq!(low.as_slice(), (-500_000_i32).to_le_bytes());
}

/// What bring-up says when node 3 answers that an object has `value`, whatever was written.
fn refused(object: u16, sub: u8, value: &'static [u8]) -> String {
    refused_by(&plan(1, 2 * MS), object, sub, value)
}

fn refused_by(plan: &ArmPlan, object: u16, sub: u8, value: &'static [u8]) -> String {
    let scanned = Offline::new(network(plan), plan).unwrap().scan();
    let mut scanned = scanned.unwrap();
    let [low, high] = object.to_le_bytes();
    let mut reads = false;
    scanned.bus_mut().tamper(Box::new(move |_, _, f| {
        if f.data().get(1..4) != Some(&[low, high, sub]) {
            return Tampering::Pass;
        }
        match f.id.raw() {
            0x603 => reads = f.data()[0] == 0x40,
            // Written: taken, also where there is no such object. Read: the value.
            0x583 => {
                let unused = u8::try_from(4 - value.len()).unwrap();
                let command = if reads { 0x43 | unused << 2 } else { 0x60 };
                let mut data = vec![command, low, high, sub];
                data.extend(value);
                data.resize(8, 0);
                return Tampering::Replace(frame(0x583, &data));
            }
            _ => {}
        }
        Tampering::Pass
    }));
    let identified = scanned.check_identity().unwrap();
    identified.map().map(|_| ()).unwrap_err().to_string()
}

/// Object, sub-index, what a drive says that it has, and why it is refused then.
const UNSAFE: [(u16, u8, &[u8], &str); 19] = [
    (
        0x6085,
        0,
        &[0x40, 0x42, 0x0F, 0],
        "6085:00 is 1000000, allowed [11000000, 110000000]",
    ),
    (0x605A, 0, &[6, 0], "605A:00 is 6, allowed [2, 2]"),
    (0x6007, 0, &[0, 0], "6007:00 is 0, allowed [3, 3]"),
    (
        0x607D,
        1,
        &[0, 0, 0, 0x80],
        "607D:01 is -2147483648, allowed [-500000, -500000]",
    ),
    (
        0x607D,
        2,
        &[0xFF, 0xFF, 0xFF, 0x7F],
        "607D:02 is 2147483647, allowed [500000, 500000]",
    ),
    (
        0x607F,
        0,
        &[0x80, 0x1A, 0x06, 0],
        "607F:00 is 400000, allowed [200000, 220000]",
    ),
    (
        0x6080,
        0,
        &[0x60, 0x09, 0, 0],
        "6080:00 is 2400, allowed [1200, 1320]",
    ),
    (
        0x6072,
        0,
        &[0xB8, 0x0B],
        "6072:00 is 3000, allowed [1, 1000]",
    ),
    (
        0x6065,
        0,
        &[0xFF; 4],
        "6065:00 is 4294967295, allowed [0, 10000]",
    ),
    (0x607E, 0, &[0x80], "607E:00 is 128, allowed [0, 0]"),
    (
        0x60B1,
        0,
        &[0xFE, 0xFF, 0xFF, 0xFF],
        "60B1:00 is -2, allowed [0, 0]",
    ),
    (0x60B2, 0, &[5, 0], "60B2:00 is 5, allowed [0, 0]"),
    (
        0x1014,
        0,
        &[0x85, 0, 0, 0],
        "1014:00 is 133, allowed [131, 131]",
    ),
    // No later than a cycle after the one before.
    (0x1015, 0, &[21, 0], "1015:00 is 21, allowed [0, 20]"),
    // Another encoder than planned.
    (
        0x608F,
        1,
        &[0xA0, 0x0F, 0, 0],
        "608F:01 is 4000, allowed [10000, 10000]",
    ),
    // Of more turns than there are numbers for, or none.
    (
        0x608F,
        2,
        &[0xFF; 4],
        "608F:02 is 4294967295, allowed [1, 429496]",
    ),
    (0x608F, 2, &[0; 4], "608F:02 is 0, allowed [1, 429496]"),
    (
        0x608F,
        2,
        &[3, 0, 0, 0],
        "608F:01 is 10000, allowed [30000, 30000]",
    ),
    // What is communication must be as it was written.
    (0x1017, 0, &[0, 0], "1017:00 is 0, allowed [100, 100]"),
];

/// A drive that keeps an unsafe value is refused with node object value and what is allowed.
#[test]
fn drive_that_keeps_an_unsafe_value_is_refused() {
    for (object, sub, value, refusal) in UNSAFE {
        assert_eq!(refused(object, sub, value), format!("node 3: {refusal}"));
    }
}

/// Turns and counts whose product no number holds are refused as any others.
#[test]
fn overflowing_encoder_resolution_is_refused() {
    let mut plan = plan(1, 2 * MS);
    plan.axes[2].counts_per_turn = u32::MAX;
    let refusal = "node 3: 608F:02 is 4294967295, allowed [1, 1]";
    assert_eq!(refused_by(&plan, 0x608F, 2, &[0xFF; 4]), refusal);
    plan.axes[2].counts_per_turn = 0;
    let refusal = "node 3: 608F:02 is 3, allowed [1, 0]";
    assert_eq!(refused_by(&plan, 0x608F, 2, &[3, 0, 0, 0]), refusal);
}
