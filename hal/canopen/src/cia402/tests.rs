use super::mode::{period_ns, period_parameter};
use super::*;

use Command::{DisableVoltage, EnableOperation, QuickStop, Shutdown, SwitchOn};
use PowerState::{
    Fault, FaultReaction, NotReady, OperationEnabled, QuickStopActive, ReadyToSwitchOn,
    SwitchOnDisabled, SwitchedOn,
};

/// The transitions of the standard's figure with their numbers; nothing else may change a state.
const TRANSITIONS: [(u8, PowerState, Event, PowerState); 26] = [
    (1, NotReady, Event::Started, SwitchOnDisabled),
    (
        2,
        SwitchOnDisabled,
        Event::Command(Shutdown),
        ReadyToSwitchOn,
    ),
    (3, ReadyToSwitchOn, Event::Command(SwitchOn), SwitchedOn),
    (
        3,
        ReadyToSwitchOn,
        Event::Command(EnableOperation),
        SwitchedOn,
    ),
    (
        4,
        SwitchedOn,
        Event::Command(EnableOperation),
        OperationEnabled,
    ),
    (5, OperationEnabled, Event::Command(SwitchOn), SwitchedOn),
    (6, SwitchedOn, Event::Command(Shutdown), ReadyToSwitchOn),
    (
        7,
        ReadyToSwitchOn,
        Event::Command(DisableVoltage),
        SwitchOnDisabled,
    ),
    (
        7,
        ReadyToSwitchOn,
        Event::Command(QuickStop),
        SwitchOnDisabled,
    ),
    (
        8,
        OperationEnabled,
        Event::Command(Shutdown),
        ReadyToSwitchOn,
    ),
    (
        9,
        OperationEnabled,
        Event::Command(DisableVoltage),
        SwitchOnDisabled,
    ),
    (
        10,
        SwitchedOn,
        Event::Command(DisableVoltage),
        SwitchOnDisabled,
    ),
    (10, SwitchedOn, Event::Command(QuickStop), SwitchOnDisabled),
    (
        11,
        OperationEnabled,
        Event::Command(QuickStop),
        QuickStopActive,
    ),
    (
        12,
        QuickStopActive,
        Event::Command(DisableVoltage),
        SwitchOnDisabled,
    ),
    (12, QuickStopActive, Event::QuickStopDone, SwitchOnDisabled),
    (13, NotReady, Event::FaultDetected, FaultReaction),
    (13, SwitchOnDisabled, Event::FaultDetected, FaultReaction),
    (13, ReadyToSwitchOn, Event::FaultDetected, FaultReaction),
    (13, SwitchedOn, Event::FaultDetected, FaultReaction),
    (13, OperationEnabled, Event::FaultDetected, FaultReaction),
    (13, QuickStopActive, Event::FaultDetected, FaultReaction),
    (14, FaultReaction, Event::FaultReactionDone, Fault),
    (15, Fault, Event::FaultReset, SwitchOnDisabled),
    (
        16,
        QuickStopActive,
        Event::Command(EnableOperation),
        OperationEnabled,
    ),
    (
        0,
        OperationEnabled,
        Event::Command(EnableOperation),
        OperationEnabled,
    ),
];

const EVENTS: [Event; 10] = [
    Event::Started,
    Event::Command(Shutdown),
    Event::Command(SwitchOn),
    Event::Command(EnableOperation),
    Event::Command(DisableVoltage),
    Event::Command(QuickStop),
    Event::FaultReset,
    Event::FaultDetected,
    Event::FaultReactionDone,
    Event::QuickStopDone,
];

#[test]
fn power_states_change_as_the_standard_says_and_not_otherwise() {
    for from in PowerState::ALL {
        for event in EVENTS {
            let listed = TRANSITIONS
                .iter()
                .find(|(_, at, on, _)| *at == from && *on == event);
            let expected = listed.map_or(from, |(_, _, _, to)| *to);
            assert_eq!(from.next(event), expected, "{from:?} on {event:?}");
        }
    }
}

#[test]
fn a_master_that_goes_one_confirmed_state_at_a_time_arrives() {
    for mut state in PowerState::ALL {
        for _ in 0..4 {
            if let Some(command) = state.towards_enabled() {
                state = state.next(Event::Command(command));
            }
        }
        let helpless = matches!(state, NotReady | FaultReaction | Fault);
        assert!(helpless || state == OperationEnabled, "{state:?}");
    }
}

#[test]
fn every_status_word_parses_to_what_returns_or_to_an_error() {
    let mut parsed = 0_u32;
    for raw in 0..=u16::MAX {
        if let Ok(status) = Status::parse(raw) {
            parsed += 1;
            assert_eq!(Status::parse(status.emit()), Ok(status));
        }
    }
    // Four states of the 64 patterns of the six state bits with bit 5 open, four with it fixed: 12
    // of 64.
    assert_eq!(parsed, 65_536 * 12 / 64);
    for state in PowerState::ALL {
        let status = Status {
            state,
            voltage: true,
            warning: false,
            remote: true,
            target_reached: true,
            internal_limit: false,
            follows: true,
            deviation: false,
        };
        assert_eq!(Status::parse(status.emit()), Ok(status));
    }
}

#[test]
fn every_control_word_parses_to_what_returns_or_to_an_error() {
    for raw in 0..=u16::MAX {
        if let Ok(control) = Control::parse(raw) {
            assert_eq!(Control::parse(control.emit()), Ok(control));
        }
    }
    let commands = [
        (0x06, Shutdown),
        (0x07, SwitchOn),
        (0x0F, EnableOperation),
        (0x00, DisableVoltage),
        (0x02, QuickStop),
    ];
    for (raw, command) in commands {
        assert_eq!(Control::parse(raw), Ok(Control::new(command)));
        assert_eq!(Control::new(command).emit(), raw);
    }
    assert!(Control::parse(0x8000).is_err());
}

#[test]
fn modes_and_periods_return() {
    for raw in i8::MIN..=i8::MAX {
        if let Ok(mode) = Mode::try_from(raw) {
            assert_eq!(mode.raw(), raw);
        }
    }
    assert_eq!(Mode::CyclicPosition.supported_bit(), 1 << (8 - 1));
    assert_eq!(period_ns(1, -3), Some(1_000_000));
    assert_eq!(period_ns(250, -6), Some(250_000));
    assert_eq!(period_parameter(2_000_000), Some((2, -3)));
    assert_eq!(period_parameter(250_000), Some((25, -5)));
    assert_eq!(period_parameter(0), None);
    for value in 1..=255 {
        for exponent in -9..=0 {
            let period = period_ns(value, exponent).unwrap();
            let (value, exponent) = period_parameter(period).unwrap();
            assert_eq!(period_ns(value, exponent), Some(period));
        }
    }
}
