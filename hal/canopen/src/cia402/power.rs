//! The power state machine of a drive.
//!
//! CiA 402-2, figure 4 and table 30 (transitions 0 to 16).

/// Where a drive stands between dead and moving.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerState {
    /// Starting up.
    NotReady,
    /// Waiting; power may be off.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power is on, no torque.
    SwitchedOn,
    /// Torque, and set-points are followed.
    OperationEnabled,
    /// Braking, or at rest after it.
    QuickStopActive,
    /// Braking because of a fault.
    FaultReaction,
    /// Nothing moves until the fault is reset.
    Fault,
}

/// What the control word asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Control word 06h.
    Shutdown,
    /// Control word 07h: switch on, or disable operation when it is enabled.
    SwitchOn,
    /// Control word 0Fh.
    EnableOperation,
    /// Control word 00h.
    DisableVoltage,
    /// Control word 02h.
    QuickStop,
}

/// What makes a drive change its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Start-up is over.
    Started,
    /// The control word.
    Command(Command),
    /// A rising edge of the control word's bit 7.
    FaultReset,
    /// Something failed.
    FaultDetected,
    /// The motor rests after a fault.
    FaultReactionDone,
    /// The motor rests after a quick stop whose option code (605Ah) does not hold it there.
    QuickStopDone,
}

impl PowerState {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::NotReady,
        Self::SwitchOnDisabled,
        Self::ReadyToSwitchOn,
        Self::SwitchedOn,
        Self::OperationEnabled,
        Self::QuickStopActive,
        Self::FaultReaction,
        Self::Fault,
    ];

    /// The state after `event`; the same one where the standard has no transition.
    ///
    /// ```text
    /// from \ event        started   shutdown  switch on  enable   voltage  quick   reset  fault     done
    /// not ready           1 sod                                                           13 react
    /// switch-on disabled            2 ready                                               13 react
    /// ready to switch on                      3 on       3 on     7 sod    7 sod          13 react
    /// switched on                   6 ready              4 oper   10 sod   10 sod         13 react
    /// operation enabled             8 ready   5 on                9 sod    11 stop        13 react
    /// quick stop active                                  16 oper  12 sod                  13 react  12 sod
    /// fault reaction                                                                                14 fault
    /// fault                                                                       15 sod
    /// ```
    ///
    /// Enabling operation from ready-to-switch-on passes through switched-on: the control word
    /// stays, so its next look at it goes on.
    #[must_use]
    pub const fn next(self, event: Event) -> Self {
        match self {
            Self::NotReady => match event {
                Event::Started => Self::SwitchOnDisabled,
                Event::FaultDetected => Self::FaultReaction,
                Event::Command(_)
                | Event::FaultReset
                | Event::FaultReactionDone
                | Event::QuickStopDone => self,
            },
            Self::SwitchOnDisabled
            | Self::ReadyToSwitchOn
            | Self::SwitchedOn
            | Self::OperationEnabled
            | Self::QuickStopActive => match event {
                Event::Command(command) => self.commanded(command),
                Event::FaultDetected => Self::FaultReaction,
                Event::QuickStopDone => match self {
                    Self::QuickStopActive => Self::SwitchOnDisabled,
                    Self::NotReady
                    | Self::SwitchOnDisabled
                    | Self::ReadyToSwitchOn
                    | Self::SwitchedOn
                    | Self::OperationEnabled
                    | Self::FaultReaction
                    | Self::Fault => self,
                },
                Event::Started | Event::FaultReset | Event::FaultReactionDone => self,
            },
            Self::FaultReaction => match event {
                Event::FaultReactionDone => Self::Fault,
                Event::Started
                | Event::Command(_)
                | Event::FaultReset
                | Event::FaultDetected
                | Event::QuickStopDone => self,
            },
            Self::Fault => match event {
                Event::FaultReset => Self::SwitchOnDisabled,
                Event::Started
                | Event::Command(_)
                | Event::FaultDetected
                | Event::FaultReactionDone
                | Event::QuickStopDone => self,
            },
        }
    }

    const fn commanded(self, command: Command) -> Self {
        match (self, command) {
            (
                Self::SwitchOnDisabled | Self::SwitchedOn | Self::OperationEnabled,
                Command::Shutdown,
            )
            | (Self::ReadyToSwitchOn, Command::Shutdown) => Self::ReadyToSwitchOn,
            (
                Self::ReadyToSwitchOn | Self::SwitchedOn | Self::OperationEnabled,
                Command::SwitchOn,
            )
            | (Self::ReadyToSwitchOn, Command::EnableOperation) => Self::SwitchedOn,
            (
                Self::SwitchedOn | Self::OperationEnabled | Self::QuickStopActive,
                Command::EnableOperation,
            ) => Self::OperationEnabled,
            (
                Self::ReadyToSwitchOn
                | Self::SwitchedOn
                | Self::OperationEnabled
                | Self::QuickStopActive,
                Command::DisableVoltage,
            )
            | (Self::ReadyToSwitchOn | Self::SwitchedOn, Command::QuickStop) => {
                Self::SwitchOnDisabled
            }
            (Self::OperationEnabled, Command::QuickStop) => Self::QuickStopActive,
            (Self::SwitchOnDisabled, Command::SwitchOn | Command::EnableOperation)
            | (Self::SwitchOnDisabled, Command::DisableVoltage | Command::QuickStop)
            | (Self::QuickStopActive, Command::Shutdown | Command::SwitchOn | Command::QuickStop)
            | (Self::NotReady | Self::FaultReaction | Self::Fault, _) => self,
        }
    }

    /// Whether the motor has torque.
    #[must_use]
    pub const fn has_torque(self) -> bool {
        matches!(
            self,
            Self::OperationEnabled | Self::QuickStopActive | Self::FaultReaction
        )
    }

    /// What a master says next to bring a drive in this state to operation enabled, one confirmed
    /// state at a time; none where only a fault reset, or waiting, helps.
    #[must_use]
    pub const fn towards_enabled(self) -> Option<Command> {
        match self {
            Self::SwitchOnDisabled => Some(Command::Shutdown),
            Self::ReadyToSwitchOn => Some(Command::SwitchOn),
            Self::SwitchedOn | Self::OperationEnabled => Some(Command::EnableOperation),
            Self::QuickStopActive => Some(Command::DisableVoltage),
            Self::NotReady | Self::FaultReaction | Self::Fault => None,
        }
    }

    /// What a master says next to take a drive in this state down to switch-on disabled, one
    /// confirmed state at a time: operation disabled (0007h), shut down (0006h), no voltage
    /// (0000h).
    #[must_use]
    pub const fn towards_disabled(self) -> Command {
        match self {
            Self::OperationEnabled => Command::SwitchOn,
            Self::SwitchedOn => Command::Shutdown,
            Self::NotReady
            | Self::SwitchOnDisabled
            | Self::ReadyToSwitchOn
            | Self::QuickStopActive
            | Self::FaultReaction
            | Self::Fault => Command::DisableVoltage,
        }
    }
}
