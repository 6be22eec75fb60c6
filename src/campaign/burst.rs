//! One burst of the trigger unit: cycles begun, frames collected and placed, a cycle accepted or taken again.

use super::matching::Matcher;
use super::origin::BurstClock;
use super::{CampaignError, Engine, Interrupt, Label, Step, Streaks, WISH_POLL, Wish, camera_trouble};
use crate::journal::Record;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Begun, CameraClock, Frame, ShotProgram};
use ditd_drivers::quantity::Kelvin;
use std::time::Duration;
use tokio::time::Instant;

/// Added to the planned time of a frame before it counts as missing: read-out, transport, and the time between
/// the trigger unit's start and its confirmation (two commands of 10 ms, 9520 manual).
const FRAME_MARGIN: Duration = Duration::from_millis(1500);

/// Time that a frame needs from the camera to us beyond its exposure, when it comes at all: transport over a gigabit
/// takes 5 ms (measured with a loopback camera: median 5 ms, 16 ms at most under load).
const LISTEN_MARGIN: Duration = Duration::from_millis(50);

/// How long before a cycle is due a unit that is begun cycle by cycle is asked whether it may begin: three questions of
/// some 50 ms, and one of them may be answered late and cost a second and the search for the thread.
const READY_LEAD: Duration = Duration::from_secs(3);

/// Cycles in a row without a single frame after which the burst is ended and the missing cycles are left to a new one, for
/// which camera and trigger unit are started anew: a stream that got stuck comes back by that.
const SILENT_CYCLES_RESTART: u32 = 2;

/// Cycles in a row without a single frame after which the trigger or the camera is taken for dead.
const SILENT_CYCLES_MAX: u32 = 4;

/// Lines that may be lost and opened again in the bursts of one level before the campaign gives up: a plug that was touched
/// is one, a loose contact is many.
const LOSSES_MAX: u32 = 3;

/// What became of one cycle.
enum Collected {
    Complete,
    Rejected { reason: String, frames: u32 },
}

impl Engine<'_> {
    /// A burst, in whose middle a line may be lost and opened again: then no unit goes on by itself. Clock and camera are
    /// stopped, and the cycles that do not count yet are left to a new burst.
    pub(super) async fn burst_to_the_end(
        &mut self,
        level: u32,
        planned: &ShotProgram,
        cycles: u32,
        shutter: Option<Kelvin>,
        streaks: &mut Streaks,
    ) -> Step<bool> {
        match self.burst(level, planned, cycles, shutter, &mut streaks.silent).await {
            Err(Interrupt::Error(CampaignError::Driver(loss)))
                if loss.is_reopened() && streaks.losses < LOSSES_MAX =>
            {
                streaks.losses += 1;
                self.progress.note(&format!("level {}: cycles are taken again: {loss}", level + 1));
                self.instruments.trigger.make_safe().await?;
                if planned.inject {
                    // What the unit did while its line was gone nobody knows.
                    self.last_injection = Some(Instant::now());
                }
                self.instruments.camera.stop().await.map_err(camera_trouble)?;
                Ok(true)
            }
            taken => taken,
        }
    }

    /// Takes `cycles` cycles in one burst of the trigger unit. False when the plate left its band and has to be
    /// soaked again before more cycles are taken.
    async fn burst(
        &mut self,
        level: u32,
        planned: &ShotProgram,
        cycles: u32,
        shutter: Option<Kelvin>,
        silent: &mut u32,
    ) -> Step<bool> {
        let program = ShotProgram { cycles, ..planned.clone() };
        let program = self.instruments.trigger.program(&program).await?;
        let first_cycle = self.recorder.reduced().levels[level as usize].next_cycle;
        let shutter_k = shutter.map(|kelvin| kelvin.0);
        self.note(Record::Burst { level, program: program.clone(), first_cycle, shutter_k })?;
        self.note(Record::Intent { act: "start the trigger clock".to_owned(), level: Some(level) })?;
        self.instruments.camera.start().await.map_err(camera_trouble)?;
        let clock = self.instruments.camera.clock().await.map_err(camera_trouble)?;
        if program.inject {
            self.last_injection = Some(Instant::now());
        }
        let begun = self.instruments.trigger.start().await?;
        self.note(Record::Done { act: "start the trigger clock".to_owned(), level: Some(level) })?;
        let outcome =
            self.collect_burst(level, &program, first_cycle, shutter.is_some(), (begun, clock), silent).await;
        // Even after trouble or a wish the clock must stand before anything else is commanded.
        let stopped = self.instruments.trigger.stop().await;
        let camera = self.instruments.camera.stop().await;
        self.note_transport(level)?;
        let in_band = outcome?;
        stopped?;
        camera.map_err(camera_trouble)?;
        Ok(in_band)
    }

    /// What the camera's transport counted in the burst, where it counts.
    fn note_transport(&mut self, level: u32) -> Step<()> {
        let counted = self.instruments.camera.counters();
        if counted.is_empty() {
            return Ok(());
        }
        let counters = counted.into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
        self.note(Record::Transport { level, counters })?;
        Ok(())
    }

    async fn collect_burst(
        &mut self,
        level: u32,
        program: &ShotProgram,
        first_cycle: u32,
        shutter: bool,
        (begun, clock): (Begun, Option<CameraClock>),
        silent: &mut u32,
    ) -> Step<bool> {
        let mut matcher = Matcher::new(program.clone(), self.origins);
        matcher.began(clock.map(|clock| BurstClock::new(begun, 0, clock)));
        let mut carry: Option<Frame> = None;
        let mut begun = begun.earliest;
        for cycle in 0..program.cycles {
            let number = first_cycle + cycle;
            if self.instruments.trigger.is_begun_by_cycle() {
                begun = self.begin_cycle(level, program, cycle, begun, clock, &mut matcher).await?;
            }
            self.note(Record::Intent { act: format!("cycle {number}"), level: Some(level) })?;
            let collected = self
                .collect_cycle(level, program, cycle, number, shutter, begun, &mut matcher, &mut carry)
                .await;
            if let Err(Interrupt::CameraLost(error)) = &collected {
                self.reject(level, number, format!("the camera is gone: {error}"))?;
            }
            self.origins = matcher.origins();
            let collected = collected?;
            if program.inject {
                let spray = program.frame_ns(cycle, program.frames_per_cycle() - 1);
                self.last_injection = Some((begun + Duration::from_nanos(spray)).max(Instant::now()));
            }
            let (reading, values) = self.read_plate(level).await?;
            self.note_values(level, Some(number), values)?;
            let target = self.plan.levels[level as usize].set_point_k;
            let off = (reading.apparent.0 - target).abs();
            // `!(off <= …)` also catches a reading that is not a number.
            let in_band = off <= self.config.soak.band_k;
            matcher.collected(matches!(collected, Collected::Complete));
            match collected {
                Collected::Complete if in_band => {
                    *silent = 0;
                    self.note(Record::CycleAccepted { level, cycle: number, reading })?;
                    self.show_cycle(level);
                }
                Collected::Complete => {
                    let reason = format!(
                        "the plate read {:.2} K, outside {target:.2} ± {:.2} K",
                        reading.apparent.0, self.config.soak.band_k
                    );
                    self.reject(level, number, reason)?;
                    return Ok(false);
                }
                Collected::Rejected { reason, frames } => {
                    *silent = if frames == 0 { *silent + 1 } else { 0 };
                    let rejected = self.reject(level, number, reason);
                    if frames == 0 {
                        // A camera that is gone is silent, too: a few seconds before it counts as gone.
                        self.instruments.camera.check().await.map_err(camera_trouble)?;
                    }
                    // Silence is the better reason where it has used the retakes up.
                    let given_up =
                        matches!(rejected, Err(Interrupt::Error(CampaignError::TooManyRetakes { .. })));
                    if *silent >= SILENT_CYCLES_MAX || (given_up && *silent >= SILENT_CYCLES_RESTART) {
                        let running = self.instruments.trigger.running().await?;
                        let state = if running { "running" } else { "stopped" };
                        return Err(Interrupt::Error(CampaignError::NoFrames {
                            level: level + 1,
                            cycles: *silent,
                            state,
                        }));
                    }
                    rejected?;
                    if *silent == SILENT_CYCLES_RESTART {
                        return Ok(true);
                    }
                }
            }
            self.heed(Wish::Pause)?;
        }
        Ok(true)
    }

    /// Begins a cycle on a unit that makes no pauses by itself. `begun` is when the burst began by the last cycle's own
    /// clock; returns the same by this one's.
    async fn begin_cycle(
        &mut self,
        level: u32,
        program: &ShotProgram,
        cycle: u32,
        begun: Instant,
        clock: Option<CameraClock>,
        matcher: &mut Matcher,
    ) -> Step<Instant> {
        let ahead_ns = program.frame_ns(cycle, 0);
        let offset = Duration::from_nanos(ahead_ns);
        let due = begun + offset;
        let reason = format!(
            "level {}: cycle {} of {}: pause, residual vapour is flushed out",
            level + 1,
            cycle + 1,
            program.cycles
        );
        self.heed(Wish::Pause)?;
        self.await_due(due, READY_LEAD, &reason).await?;
        let due = self.instruments.trigger.ready_cycle(cycle, due).await?.max(due);
        self.await_due(due, WISH_POLL, &reason).await?;
        self.heed(Wish::Pause)?;
        if program.inject {
            // Whatever happens from here on, fuel may come.
            let spray = program.frame_ns(0, program.frames_per_cycle() - 1) - program.frame_ns(0, 0);
            self.last_injection = Some(due.max(Instant::now()) + Duration::from_nanos(spray));
        }
        let fired = self.instruments.trigger.begin_cycle(cycle, due).await?;
        matcher.began(clock.map(|clock| BurstClock::new(fired, ahead_ns, clock)));
        let fired = fired.earliest;
        matcher.begin(cycle, u64::try_from((fired - self.started).as_nanos()).unwrap_or(u64::MAX));
        Ok(fired.checked_sub(offset).unwrap_or(fired))
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one cycle's whole context; a struct would live for this call only"
    )]
    async fn collect_cycle(
        &mut self,
        level: u32,
        program: &ShotProgram,
        cycle: u32,
        number: u32,
        shutter: bool,
        begun: Instant,
        matcher: &mut Matcher,
        carry: &mut Option<Frame>,
    ) -> Step<Collected> {
        let wanted = program.frames_per_cycle();
        let mut due = 0u32;
        let mut last_id: Option<u64> = None;
        let mut received = 0u32;
        let mut trouble: Option<String> = None;
        while due < wanted {
            let frame = match carry.take() {
                Some(frame) => Some(frame),
                None => {
                    let planned = Duration::from_nanos(
                        program.frame_ns(cycle, due) + program.camera_delay_ns + program.camera_width_ns,
                    );
                    self.await_frame(begun + planned + FRAME_MARGIN, level, cycle, due, program).await?
                }
            };
            let Some(frame) = frame else {
                trouble.get_or_insert(format!("frame {} of {wanted} did not come", due + 1));
                due += 1;
                continue;
            };
            received += 1;
            let place = match matcher.place(frame.device_ns, cycle) {
                Ok(place) => place,
                Err(why) => {
                    trouble.get_or_insert(format!("frame number {}: {why}", frame.id));
                    continue;
                }
            };
            if place.cycle > cycle {
                *carry = Some(frame);
                received -= 1;
                trouble.get_or_insert(format!("frame {} of {wanted} did not come", due + 1));
                break;
            }
            if place.cycle < cycle || place.position < due {
                trouble.get_or_insert(format!("frame number {} came twice or late", frame.id));
                continue;
            }
            if place.position > due {
                trouble.get_or_insert(format!("frame {} of {wanted} did not come", due + 1));
            }
            if last_id.is_some_and(|last| frame.id != last + u64::from(place.position - due) + 1) {
                trouble.get_or_insert(format!("the camera's frame number jumped to {}", frame.id));
            }
            if !frame.complete {
                trouble.get_or_insert(format!("frame number {} is incomplete", frame.id));
            }
            last_id = Some(frame.id);
            due = place.position + 1;
            let shot = program.kind_at(place.position).expect("positions were checked by the matcher");
            let t_ns = self.now_ns();
            let label = Label { level, cycle: number, position: place.position, shot, shutter };
            self.recorder.frame(t_ns, label, &frame)?;
        }
        if trouble.is_none() {
            trouble = self.one_too_many(program, cycle, begun, matcher, carry).await?;
        }
        let trouble = trouble.or(matcher.doubt());
        Ok(match trouble {
            None => Collected::Complete,
            Some(reason) => Collected::Rejected { reason, frames: received },
        })
    }

    /// Listens for one more clock period after a complete cycle: a frame there means that one came too many, perhaps
    /// before the first, and that every label of the cycle is in doubt.
    async fn one_too_many(
        &mut self,
        program: &ShotProgram,
        cycle: u32,
        begun: Instant,
        matcher: &mut Matcher,
        carry: &mut Option<Frame>,
    ) -> Step<Option<String>> {
        let after = program.frame_ns(cycle, program.frames_per_cycle()) + program.camera_delay_ns;
        let until = (begun + Duration::from_nanos(after)).max(Instant::now())
            + Duration::from_nanos(program.period_ns / 2)
            + LISTEN_MARGIN;
        let Some(frame) = self.await_frame(until, 0, cycle, 1, program).await? else { return Ok(None) };
        Ok(match matcher.place(frame.device_ns, cycle) {
            Ok(place) if place.cycle > cycle => {
                *carry = Some(frame);
                None
            }
            _ => Some(format!("frame number {} is one too many", frame.id)),
        })
    }

    /// The next frame, or `None` when it is not there at `deadline`.
    async fn await_frame(
        &mut self,
        deadline: Instant,
        level: u32,
        cycle: u32,
        due: u32,
        program: &ShotProgram,
    ) -> Step<Option<Frame>> {
        loop {
            self.heed(Wish::Stop)?;
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            if due == 0 && left > FRAME_MARGIN {
                let reason = format!(
                    "level {}: cycle {} of {}: pause, residual vapour is flushed out",
                    level + 1,
                    cycle + 1,
                    program.cycles
                );
                self.progress.waiting(&reason, Some((left - FRAME_MARGIN).as_secs_f64()));
            }
            match self.instruments.camera.frame(left.min(WISH_POLL)).await {
                Ok(frame) => return Ok(Some(frame)),
                Err(DriverError::Silent { .. }) => {}
                Err(error) => return Err(camera_trouble(error)),
            }
        }
    }
}
