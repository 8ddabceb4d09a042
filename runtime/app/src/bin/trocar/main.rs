//! The `trocar` command: reads the command line, calls the library, and turns the result into an
//! exit code.
//!
//! Exit codes: 0 done, 1 failed at its job, 2 bad usage or bad input.
//!
//! A verb is a `Verb` with its arguments (`args`), a function in a module of its own or in
//! `commands`, and a line in `done`. What it prints goes through `console`, which keeps standard
//! output to results.

mod about;
mod anatomy;
mod args;
mod black_box;
mod cameras;
mod commands;
mod console;
mod drives;
mod environment;
mod eval;
mod export;
mod import;
mod import_log;
mod operator;
mod page;
mod policy;
mod provenance;
mod record;
mod replay;
mod run_report;
mod scene_args;
mod segment;
mod sheet;
mod simulator;
mod study;
mod train;
mod train_args;

use clap::Parser;

use trocar::rt;
use trocar::session::operator::Command;
use trocar::session::{SessionError, outputs};
use trocar_control::OperatorEvent;

use args::{Cli, Verb};
use operator::{mark, operate, watch};

/// Counts, so that a run can say what its control thread asked for.
#[global_allocator]
static ALLOCATOR: rt::CountingAllocator = rt::CountingAllocator;

/// A panic ends the program at once, in whichever thread: nothing goes on beside one that is gone,
/// and the drives see to the rest. Only where a dataset's file is read, which its reader panics at,
/// is it bad input, and becomes an error that names the file.
fn panics_end_the_program() {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if trocar_data::dataset::file_being_read().is_none() {
            before(panic);
            std::process::abort();
        }
    }));
}

/// It ends without destructors and without libtorch's own clean-up: what has to be written is on
/// disk by then.
fn main() {
    rt::quieten_mesa();
    panics_end_the_program();
    rt::end_process(exit_code())
}

/// Does what the command line says; the program's exit code.
///
/// The order matters: a child of a study asks to die with its parent first of all; only what clap
/// accepts is looked at further; and where JSON goes to standard output nothing else may be printed
/// there before. A result that could not be printed is exit code 1, though the verb has done its
/// job.
fn exit_code() -> u8 {
    if let Err(error) = trocar::study::child::end_with_parent() {
        console::error(&error);
        return 1;
    }
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => return console::usage(&answer),
    };
    if let Err(error) = rt::check_slow_motion() {
        console::error(&error);
        return 2;
    }
    if rt::slow_motion() > 1 {
        console::warning(&format!(
            "TROCAR_SLOW_MOTION: everything takes {} times as long",
            rt::slow_motion()
        ));
    }
    if cli.verb.json().is_some_and(outputs::is_standard_output) {
        console::leave_stdout_to_json();
    }
    match done(&cli.verb) {
        Ok(true) if !console::stdout_failed() => 0,
        Ok(_) => 1,
        Err(error) => {
            console::error(&error);
            if error.is_bad_input() { 2 } else { 1 }
        }
    }
}

/// Does what `verb` says; whether it was done.
///
/// Verbs of the operator are sent to the run's socket by `operator`, and all others run here.
fn done(verb: &Verb) -> Result<bool, SessionError> {
    match verb {
        Verb::Run(args) => commands::run(args),
        Verb::Eval(args) => eval::eval(args),
        Verb::Record(args) => record::record(args),
        Verb::Import(verb) => import::import(verb),
        Verb::Export(verb) => export::export(verb),
        Verb::Train(args) => train::train(args),
        Verb::Study(args) => study::study(args),
        Verb::Report(args) => study::report(args),
        Verb::Replay(args) => replay::replay(args),
        Verb::Verify(args) => commands::verify(args),
        Verb::Drives(args) => drives::drives(args),
        Verb::Simulator(args) => simulator::simulator(args),
        Verb::Doctor(args) => commands::doctor(args),
        Verb::Demo(args) => commands::demo(args),
        Verb::Anatomy(verb) => anatomy::anatomy(verb),
        Verb::Sheet(args) => sheet::sheet(args),
        Verb::Status(args) => operate(Command::Status, args),
        Verb::Monitor(args) => watch(args),
        Verb::Mark(args) => mark(args),
        Verb::Home(args) => operate(Command::Home, args),
        Verb::Stop(args) => operate(Command::Stop, args),
        Verb::Enable(args) => operate(Command::Event(OperatorEvent::Enable), args),
        Verb::Disable(args) => operate(Command::Event(OperatorEvent::Disable), args),
        Verb::Pause(args) => operate(Command::Event(OperatorEvent::Pause), args),
        Verb::Resume(args) => operate(Command::Event(OperatorEvent::Resume), args),
        Verb::Clear(args) => operate(Command::Event(OperatorEvent::Clear), args),
        Verb::Speed(args) => {
            let percent = args.percent;
            operate(Command::Event(OperatorEvent::Speed { percent }), &args.of)
        }
        Verb::Config(verb) => about::config(verb),
        Verb::Completions(args) => about::completions(args),
        Verb::Man(args) => about::man(args),
        Verb::Policy(args) => policy::policy(args),
        Verb::Cameras(args) => cameras::cameras(args),
        Verb::PolicyProcess(args) => commands::policy_process(args),
        Verb::Environment(args) => environment::environment(args),
    }
}
