//! External policies that are threads of the test.

use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{ArmObservation, ArmState, JointVector, Pose, TipTarget};
use trocar_topics::{
    Line, PolicyHello, PolicyHelloTopic, PolicyReplyTopic, PolicyStatus, PolicyStatusTopic,
    RunControlTopic, TopicNode,
};

use super::link::{FIRST_ARM, checked};
use super::*;
use crate::rt;
use crate::session::PolicyChoice;
use crate::session::source::STEP_NS;

fn setup(task: &str) -> Setup {
    Setup::load(task, None, &PolicyChoice::Noop).unwrap()
}

fn choice(test: &str, within_s: u64) -> ExternalChoice {
    ExternalChoice {
        name: Some(format!("test-{}-{test}", process::id())),
        within_s,
        instruction: None,
    }
}

fn hello() -> PolicyHello {
    PolicyHello {
        pid: u64::from(process::id()),
        query_every_steps: 5,
        name: Line::new("thread"),
        ..PolicyHello::default()
    }
}

fn arm_at(tick: u64) -> ArmObservation {
    ArmObservation {
        state: ArmState::at_rest(TimeNs::from_tick(tick), JointVector::zeros(), 0.1),
        tip_in_rcm: Pose::identity(),
    }
}

fn target(report: &ArmReport) -> TipTarget {
    TipTarget::new(&report.tip_in_rcm(), report.jaw_position + 0.5)
}

/// The policy's end, which says `reply` of each observation and, if it answers, publishes `chunks`
/// chunks of `late_ns` after it.
fn serve(topics: &str, hello: &PolicyHello, reply: Reply, late_ns: u64, done: &AtomicBool) {
    let node = TopicNode::join(topics).unwrap();
    let hellos = PolicyHelloTopic::publisher(&node, FIRST_ARM).unwrap();
    let control = RunControlTopic::subscriber(&node, FIRST_ARM).unwrap();
    let status = PolicyStatusTopic::publisher(&node, FIRST_ARM).unwrap();
    let reports = ArmStateTopic::subscriber(&node, FIRST_ARM).unwrap();
    let chunks = ChunkTopic::publisher(&node, FIRST_ARM).unwrap();
    let replies = PolicyReplyTopic::publisher(&node, FIRST_ARM).unwrap();
    hellos.publish(hello).unwrap();
    let mut episode = 0;
    while !done.load(Ordering::Acquire) {
        hellos.keep_alive().unwrap();
        if let Some(control) = control.newest().unwrap() {
            episode = control.episode;
            let ready = PolicyStatus::new(1, episode, PolicyStage::Ready, 0, 0);
            status.publish(&ready).unwrap();
        }
        if let Some(report) = reports.newest().unwrap() {
            let at = report.stamp.plus_ns(late_ns);
            let chunk = Chunk::new(at, 1 + report.sequence, STEP_NS, &[target(&report); 3]);
            chunks.publish(&chunk).unwrap();
            let said = PolicyReply::new(episode, report.sequence, reply, 1, "no weights");
            replies.publish(&said).unwrap();
        }
        rt::sleep_ns(LOOK_NS / 100);
    }
}

/// What the session makes of a policy that replies so to the observation at 40 ms.
fn asked(test: &str, reply: Reply, late_ns: u64) -> Result<Vec<Chunk>, PolicyError> {
    let (choice, done) = (choice(test, 20), AtomicBool::new(false));
    thread::scope(|scope| {
        scope.spawn(|| serve(choice.topics(), &hello(), reply, late_ns, &done));
        let mut policy =
            ExternalPolicy::connect(&choice, &setup("needle-lift"), PolicySteps::USUAL).unwrap();
        assert_eq!(policy.query_every_steps(), 5);
        policy.reset(7);
        let arms = [arm_at(40)];
        let said = policy.infer(&Observation {
            arms: &arms,
            frames: &[],
        });
        done.store(true, Ordering::Release);
        said
    })
}

#[test]
fn an_external_policy_answers_the_observation_it_is_shown() {
    let chunks = asked("answers", Reply::Answered, 0).unwrap();
    assert_eq!(chunks.len(), 1);
    let chunk = &chunks[0];
    assert_eq!(
        (chunk.observed_at, chunk.sequence),
        (TimeNs::from_tick(40), 2)
    );
    let jaws: Vec<f64> = chunk.valid_targets().iter().map(|it| it.jaw).collect();
    assert_eq!(jaws, [0.6; 3]);
}

#[test]
fn an_external_policy_that_fails_or_gives_up_is_named() {
    let said = asked("fails", Reply::Failed, 0).unwrap_err().to_string();
    assert!(said.contains("test-") && said.contains("thread"), "{said}");
    assert!(said.ends_with("failed: no weights"), "{said}");
    let abandoned = asked("abandons", Reply::Abandoned, 0).unwrap_err();
    assert!(matches!(abandoned, PolicyError::Abandoned { .. }));
    let observed = asked("observes", Reply::Observed, 0).unwrap_err();
    assert!(observed.to_string().contains("expected one per arm"));
}

#[test]
fn a_chunk_of_another_instant_is_no_answer() {
    let said = asked("late", Reply::Answered, 1).unwrap_err().to_string();
    let named = "a chunk for psm1 of 40000001 ns, the observation is of 40000000 ns";
    assert!(said.contains(named), "{said}");
}

#[test]
fn an_external_policy_that_never_answers_is_given_up() {
    let (choice, done) = (choice("silent", 5), AtomicBool::new(false));
    let node = TopicNode::join(choice.topics()).unwrap();
    let hellos = PolicyHelloTopic::publisher(&node, FIRST_ARM).unwrap();
    hellos.publish(&hello()).unwrap();
    let said = thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Acquire) {
                hellos.keep_alive().unwrap();
                rt::sleep_ns(LOOK_NS / 100);
            }
        });
        let mut policy =
            ExternalPolicy::connect(&choice, &setup("needle-lift"), PolicySteps::USUAL).unwrap();
        let arms = [arm_at(0)];
        let said = policy.infer(&Observation {
            arms: &arms,
            frames: &[],
        });
        done.store(true, Ordering::Release);
        said.unwrap_err().to_string()
    });
    assert!(
        said.ends_with("has not reset for the episode for 5 s"),
        "{said}"
    );
    let nobody = ExternalChoice {
        name: Some(format!("{}-nobody", choice.topics())),
        within_s: 1,
        ..choice.clone()
    };
    let error = ExternalPolicy::connect(&nobody, &setup("needle-lift"), PolicySteps::USUAL);
    let said = error.err().unwrap().to_string();
    assert!(said.ends_with("has not appeared for 1 s"), "{said}");
}

#[test]
fn an_external_policy_for_something_else_is_refused() {
    let lines = |names: &[&str]| {
        let mut cameras = [Line::default(); trocar_topics::POLICY_CAMERAS_MAX];
        for (camera, name) in cameras.iter_mut().zip(names) {
            *camera = Line::new(name);
        }
        cameras
    };
    let about = About {
        task: "needle-lift",
        instruction: "lift the needle",
        arms: 1,
        lockstep: true,
        step_ns: STEP_NS,
        frames_within_ms: 0,
    };
    let told = |change: fn(&mut PolicyHello)| {
        let mut hello = hello();
        change(&mut hello);
        checked(&hello, &about).unwrap_err()
    };
    assert_eq!(told(|it| it.arm_count = 2), "commands 2 arms, there are 1");
    let said = told(|it| it.query_every_steps = 0);
    assert!(
        said.contains("of 0 steps: allowed are 1 to 10000"),
        "{said}"
    );
    assert!(told(|it| it.history_steps = u64::MAX).contains("history"));
    assert_eq!(told(|it| it.camera_count = 9), "asks for 9 cameras");
    let seeing = PolicyHello {
        camera_count: 2,
        cameras: lines(&["endoscope", "microscope"]),
        ..hello()
    };
    let wanted = checked(&seeing, &about).unwrap();
    let error = check_wanted(&setup("needle-lift"), &wanted).unwrap_err();
    assert!(error.is_bad_input() && error.to_string().contains("\"microscope\""));
}

#[test]
fn external_policies_have_names_that_topics_can_have() {
    let parse = |text| {
        let PolicyChoice::External(choice) = PolicyChoice::parse(text) else {
            panic!("{text}");
        };
        choice
    };
    assert_eq!(parse("external").topics(), DEFAULT_NAME);
    assert_eq!(parse("external:lab").topics(), "lab");
    let named = PolicyChoice::parse("external:lab").within_s(3);
    assert_eq!(named.name(), "external:lab");
    assert_eq!(named.of_job(0, 1), named);
    let PolicyChoice::External(second) = named.of_job(1, 2) else {
        panic!("{named:?}");
    };
    assert_eq!((second.topics(), second.within_s), ("lab-2", 3));
    let error = PolicyChoice::parse("external:a/b")
        .check_exists()
        .unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    assert!(PolicyChoice::parse("external").check_exists().is_ok());
}

#[test]
fn only_external_policies_are_told_what_to_do() {
    let told = |policy: &str, text: Option<&str>| PolicyChoice::parse(policy).instructed(text);
    let PolicyChoice::External(lab) = told("external:lab", Some("lift the needle")).unwrap() else {
        panic!("external:lab");
    };
    assert_eq!(lab.instruction_or("needle-lift"), "lift the needle");
    assert_eq!(
        lab.of_job(1, 2).instruction_or("needle-lift"),
        "lift the needle"
    );
    let untold = ExternalChoice::new(None);
    assert_eq!(untold.instruction_or("needle-lift"), "needle-lift");
    assert!(told("expert", None).is_ok());
    let error = told("expert", Some("lift")).unwrap_err();
    assert!(
        error.is_bad_input() && error.to_string().contains("the policy is expert"),
        "{error}"
    );
    let long = "é".repeat(INSTRUCTION_BYTES_MAX / 2);
    assert!(
        told("external", Some(&long))
            .unwrap()
            .check_exists()
            .is_ok()
    );
    let longer = told("external", Some(&(long + "e"))).unwrap();
    let said = longer.check_exists().unwrap_err().to_string();
    assert!(
        said.contains("249 bytes of text: allowed are 1 to 248"),
        "{said}"
    );
}
