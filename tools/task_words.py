"""What no code can tell about each task: its story, the labels of its picture, its formulas in the paper's signs.

Numbers are filled in from the settings of the newest version: {c.near} is a field of its configuration, {deg[angle]}
one in degrees, {r.SIGMA} a constant of tasks/rewards.py, {B} is BOLTZMANN. `most` is the largest sum of a term over an
episode of `steps` steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import e
from typing import Any

from task_pictures import Label, Picture


@dataclass(frozen=True)
class Term:
    formula: str
    most: Callable[[Any, int], float]


@dataclass(frozen=True)
class Words:
    story: str
    picture: Picture
    tool: str
    terms: dict[str, Term]
    where: str  # what the signs in the formulas mean, with ";" between them
    helps: str
    success: str
    end: str
    draws: str
    before: str  # version 0
    touched: tuple[str, ...]  # regions of human.harm.REGIONS that the tool works on or beside
    between: str = ""  # the versions between 0 and the newest


JOINTS_ONLY = "Nothing but the noise on the joints: {what}."
B_LARGEST = e**-1.0
BOLTZMANN = "B(x) = x·exp(−x), which is largest, 1/e, at x = 1"


def _people(robot=(0.2, 0.75), person=(0.85, 0.2)) -> tuple[Label, ...]:
    return ("robot", ("body", "link3"), robot), ("person", ("body", "torso"), person)


TASKS = {
    "scratch": Words(
        "The person sits in a wheelchair and has an itch somewhere on the right arm. The robot holds a stick and "
        "scratches it; the person can lift and turn the arm so that the robot reaches the place.",
        Picture(
            "scratch_seconds",
            (*_people(), ("right arm, moved\nby the person", ("body", "right_forearm"), (0.72, 0.88))),
            (
                ("tool point", ("site", "tool_tip"), (0.2, 0.75)),
                ("target: the itch", "target", (0.72, 0.85)),
                ("upper arm", ("body", "right_upper_arm"), (0.2, 0.08)),
                ("forearm", ("body", "right_forearm"), (0.8, 0.25)),
            ),
        ),
        "a stick; the tool point is its end",
        {
            "reach": Term("exp(−(d + a)²/σ)", lambda c, steps: steps),
            "scratch": Term(
                "{c.scratch_scale:g} · [helps] · B(v / {c.speed:g}) · B(f / {c.force:g})",
                lambda c, steps: steps * c.scratch_scale * B_LARGEST**2,
            ),
        },
        "d: distance from the tool point to the itch (m); a: length of the arc around the segment from the side that "
        "the tool point is on to that of the itch (m); σ = {r.SIGMA:g} m²; "
        "v: speed of the tool point as the "
        "segment with the itch sees it, or its own in the room, whichever is less, both velocities low-pass filtered "
        "over {c.stroke_seconds:g} s (m/s); f: force of the tool on that segment (N); {B}",
        "the tool point is within {c.scratch_distance:g} m of the itch and the tool touches the segment (upper arm "
        "or forearm) that the itch is on",
        "{c.success_seconds:g} s in all in which it helps, with {c.scratch_force[0]:g} to {c.scratch_force[1]:g} N "
        "on that segment and a v of {c.scratch_speed[0]:g} to {c.scratch_speed[1]:g} m/s (`scratch_seconds`)",
        "The task itself never ends an episode.",
        "The itch: upper arm or forearm, each as likely as it has skin; a place along the segment between "
        "{c.height[0]:g} and {c.height[1]:g} half-lengths from its middle, and an angle of up to {deg[angle]}° to "
        "either side of the one that faces away from the trunk, both uniform. That is all of the skin between "
        "shoulder and wrist but for a strip of the forearm, {deg[spared]}°, where no posture that was found lets the "
        "stick work. Two in five itches can only be reached if the person moves (`tools/offers.py`).",
        "The itch lies on the outer side of the arm, away from elbow and wrist, where the robot reaches it by "
        "itself. The scratch term pays, and scratching counts, within 10 cm of the itch, wherever the tool touches "
        "the person: also on the other side of the arm.",
        ("upper_arm", "forearm", "hand", "trunk", "thigh"),
        "`scratch-v1` counts within 4 cm of the itch: nearly all itches are so near to what the stick touches while "
        "the arm rests. Its robot sees no clock, and its forearm itches all around. In `scratch-v2`, too, v is what "
        "the segment sees at that moment: a stick that trembles by 1.3 mm scratches, and one at rest on an arm that "
        "moves.",
    ),
    "bed_bath": Words(
        "The person lies in bed and one side of the right arm is dirty. The robot holds a pad and washes it; the "
        "person can lift and turn the arm so that the robot reaches the dirty side.",
        Picture(
            "fraction_visited",
            _people((0.3, 0.4), (0.72, 0.15)),
            (
                ("tool point", ("site", "tool_tip"), (0.6, 0.92)),
                ("target: the dirty point\nthat is best to reach", "target", (0.3, 0.1)),
                ("washed", ("spot", "washed"), (0.85, 0.75)),
                ("dirty", ("spot", "dirty"), (0.15, 0.85)),
            ),
            distance=0.9,
            seed=2,
        ),
        "a flat pad; the tool point is its middle",
        {
            "reach": Term(
                "mean over the dirty points of: 1 if washed, else exp(−(d + a)²/σ) · (1 + e + p) / 3",
                lambda c, steps: steps,
            ),
            "wipe": Term(
                "{c.wipe_scale:g} · (52 / m) · points washed in this step", lambda c, steps: 52.0 * c.wipe_scale
            ),
        },
        "d: distance from the tool point to a dirty point (m), and a: length of the arc around its segment from the "
        "tool's side of it to the point's (m); σ = {r.SIGMA:g} m²; e: how far the skin there faces the "
        "robot, from 0 to 1: (1 + n·b)/2 for the outward normal n and the direction b to the robot's base, level, and "
        "45° up; p: how flat the pad is to it, from 0 to 1: (1 − n·z)/2 for the way z that the pad faces; m: how many "
        "of the 52 points were dirty at the start. Washing a point costs nothing later, and when the last one is "
        "washed, that step pays the reach term, 1, for all steps that are left, too, so that finishing early does not "
        "either",
        "the pad washes: its middle is within {c.near:g} m of a dirty point, with {c.touch_force:g} to "
        "{c.most_force:g} N on its segment and a speed of {c.speed[0]:g} to {c.speed[1]:g} m/s (measured as below), "
        "until the point has had its {c.wash_seconds:g} s",
        "{c.success_fraction:.0%} of the dirty points are washed (`fraction_visited`). A point is washed after "
        "{c.wash_seconds:g} s in all within {c.near:g} m of the pad's middle, with {c.touch_force:g} to "
        "{c.most_force:g} N on its segment and a speed of {c.speed[0]:g} to {c.speed[1]:g} m/s: the pad's as that "
        "segment sees it or its own in the room, whichever is less, both velocities low-pass filtered over "
        "{c.stroke_seconds:g} s",
        "When all dirty points are washed, the episode is terminated.",
        "Which side is dirty: of 52 points, evenly over the skin of the arm, those within {deg[dirty]}° of an angle "
        "around the arm that is uniform.",
        "All 52 points lie on the upper side of the arm and are dirty. A point is done when the pad has touched "
        "anything within 5 cm of it once, however fast or hard, and 90 % make a success. An episode that ends early "
        "loses the reach reward of the steps that are left.",
        ("upper_arm", "forearm", "hand"),
        "In `bed_bath-v2` a point is washed after 0.08 s at 0.02 m/s, as its segment sees it at that moment, which is "
        "1.6 mm: a pad that trembles washes it, and one that is laid on it. `bed_bath-v1` is the same but for the "
        "clock, which its robot does not see.",
    ),
    "arm_assist": Words(
        "The person lies in bed with a weak right arm that hangs over the edge. The robot holds a hook, lifts the "
        "arm and lays it back beside the waist; the person's own strength, a fifth of what it is in the other tasks, "
        "helps a little.",
        Picture(
            "seconds_at_waist",
            _people((0.9, 0.25), (0.12, 0.25)),
            (
                ("tool point", ("site", "tool_tip"), (0.2, 0.72)),
                ("hook", ("body", "tool"), (0.15, 0.4)),
                ("target: middle of the forearm\n(wrist target)", "target", (0.62, 0.08)),
                ("waist target", ("site", "waist_target"), (0.75, 0.8)),
            ),
            distance=1.1,
            share=0.0,
            before=100,
        ),
        "a hook of two plates; the tool point is the middle of its opening",
        {
            "reach": Term("exp(−d²/σ)", lambda c, steps: steps),
            "waist": Term(
                "{c.waist_scale:g} · paid · (1 − tanh(d_H/{c.waist_width:g} m))",
                lambda c, steps: steps * c.waist_scale * 1.0,
            ),
            "rotation": Term(
                "{c.rotation_scale:g} · (2√2 − ‖R_hook − R_wrist‖_F)",
                lambda c, steps: steps * c.rotation_scale * 2.0 * 2.0**0.5,
            ),
        },
        "d: distance from the tool point to a place on the forearm {c.grip:g} m from its middle toward the hand (m); "
        "d_H: distance from the middle of the forearm to the waist target (m); σ = {r.SIGMA:g} m²; R: orientations as "
        "matrices; paid: 1 while it helps (below) and the forearm is slower than {c.settled_speed:g} m/s, and "
        "otherwise {c.unsettled:g}",
        "the middle of the forearm is within {c.waist_distance:g} m of the waist target, having been carried there "
        "below {c.carrying_speed:g} m/s since it last lay still elsewhere",
        "{c.success_seconds:g} s in all in which it helps and the forearm is slower than {c.settled_speed:g} m/s "
        "(`seconds_at_waist`), and the forearm is within {c.waist_distance:g} m of the waist target at the end",
        "The task itself never ends an episode.",
        JOINTS_ONLY.format(what="both targets are fixed to the person's body"),
        "Speed does not matter: a forearm that swings through the waist or is thrown there counts and is paid in full.",
        ("upper_arm", "forearm", "hand", "trunk", "thigh"),
        "In `arm_assist-v1` an arm that lay at the waist and falls out of bed again is a success.",
    ),
    "feeding": Words(
        "The person sits in a wheelchair. The robot holds a spoon with food and brings it to the mouth, level on the "
        "way, slow at the end; the person can turn and nod the head.",
        Picture(
            "mouth_seconds",
            (*_people((0.15, 0.3), (0.85, 0.75)), ("head, moved\nby the person", ("body", "head"), (0.82, 0.12))),
            (
                ("tool point: middle\nof the bowl", ("site", "tool_tip"), (0.28, 0.12)),
                ("target: the mouth", ("site", "mouth"), (0.5, 0.85)),
                ("head", ("body", "head"), (0.8, 0.12)),
            ),
        ),
        "a spoon; the tool point is the middle of its bowl",
        {
            "reach": Term("{c.reach_scale:g} · exp(−{r.DECAY:g}·b)", lambda c, steps: steps * c.reach_scale),
            "orientation": Term("t·up + (0.3 + 0.7·p) · (tip·inward)", lambda c, steps: steps * 2.0),
            "approach": Term("exp(−(v − v*)² / {r.APPROACH_WIDTH:g})", lambda c, steps: steps),
            "contact": Term(
                "[helps and v ≤ {c.mouth_speed:g}] · B(f / {c.force:g})", lambda c, steps: steps * B_LARGEST
            ),
        },
        "b: distance from the bowl, between tool point and tip, to the middle of the mouth (m); d: that from the tool "
        "point; p = exp(−{r.PROXIMITY:g}·d²), which is 1 at the mouth and 0 far away; up, tip: the directions of "
        "the spoon's upper side and of its tip; inward the direction into the mouth; t: the wanted up side: straight "
        "up, turned towards the mouth by p, at most {deg[most_tilt]}°; v: speed of the tool point as the head sees it "
        "(m/s); v* = {c.speed:g}·(1 − p); f force of the bowl on the person (N); {B}",
        "the spoon still has its food and its bowl, from the middle to the tip, is within {c.mouth_distance:g} m of "
        "the middle of the mouth, {c.mouth_width:g} m to either side and {c.mouth_height:g} m up or down, "
        "the bowl in front of the face, its tip pointing in, its upper side up, each within "
        "{deg[mouth_angle]}°, and the face feels it with {c.mouth_force:g} N or more",
        "{c.success_seconds:g} s in all in which it helps at {c.mouth_speed:g} m/s or less (`mouth_seconds`). The "
        "food falls (`spilled`) when the spoon is tipped by more than {deg[spill_angle]}° for {c.spill_seconds:g} s "
        "in all, or by {deg[spill_anywhere]}° at once. Tipped "
        "against gravity as the bowl feels it: gravity less the bowl's acceleration, low-pass filtered over "
        "{c.filter_seconds:g} s. What was eaten cannot fall any more",
        "The task itself never ends an episode.",
        JOINTS_ONLY.format(what="the spoon starts level and with its food, the mouth is where the head is"),
        "The direction from which the spoon comes and its speed at the mouth do not matter. Gravity alone decides "
        "about spilling, at once, and also after the food was eaten. The tip is to aim at the middle of the mouth, "
        "however the face is turned, and contact pays anywhere on the person: a spoon under the chin is paid as well "
        "as one in the mouth.",
        ("face", "skull", "neck"),
        "`feeding-v1` counts anywhere within 3 cm of the middle of the mouth, so that a spoon against the chin, 2 cm "
        "below it, feeds: trained teams held it there. Its reach term has d instead of b, and the tool point comes "
        "nearer to the mouth from below than from ahead. In both `feeding-v1` and `feeding-v2` a spoon that touches "
        "nothing feeds, and within 10 cm of the mouth food falls only by more than 90°.",
    ),
    "tooth_brushing": Words(
        "The person sits in a wheelchair. The robot holds a toothbrush, lays the bristles on the mouth and brushes; "
        "the person can turn and nod the head.",
        Picture(
            "brush_seconds",
            (*_people((0.15, 0.3), (0.85, 0.75)), ("head, moved\nby the person", ("body", "head"), (0.82, 0.12))),
            (
                ("tool point: bristles", ("site", "tool_tip"), (0.3, 0.12)),
                ("target: the mouth", ("site", "mouth"), (0.5, 0.85)),
                ("head", ("body", "head"), (0.8, 0.12)),
            ),
        ),
        "a toothbrush; the tool point is the middle of its bristles",
        {
            "reach": Term("{c.reach_scale:g} · exp(−{r.DECAY:g}·d)", lambda c, steps: steps * c.reach_scale),
            "align": Term(
                "½ · [bristle·inward + 1 − abs(handle·up)] · exp(−{r.DECAY:g}·d)", lambda c, steps: float(steps)
            ),
            "brush": Term(
                "{c.brush_scale:g} · [helps] · B(v / {c.speed:g}) · B(f / {c.force:g})",
                lambda c, steps: steps * c.brush_scale * B_LARGEST**2,
            ),
        },
        "d: distance from the bristles to the middle of the mouth (m); bristle, handle: the directions in which "
        "these point; inward: the direction into the mouth; up: straight up; v: speed of the tool point along the "
        "face (m/s), as the head sees it or its own in the room, whichever is less; f: force of the "
        "bristles on the head (N); {B}",
        "the bristles are within {c.near:g} m of the middle of the mouth, {c.mouth_width:g} m to either side and "
        "{c.mouth_height:g} m up or down, and look into the face within {deg[brush_angle]}°",
        "{c.success_seconds:g} s in all in which it helps, with {c.brush_force[0]:g} to {c.brush_force[1]:g} N and "
        "a v of {c.brush_speed[0]:g} to {c.brush_speed[1]:g} m/s (`brush_seconds`)",
        "The task itself never ends an episode.",
        JOINTS_ONLY.format(what="the mouth is where the head is"),
        "Speed is that in the room: brush and head that shake together count as brushing. The bristles are to point "
        "at the middle of the mouth, so that they may lie on a cheek, and brushing adds an eighth of what it does in "
        "version 2.",
        ("face", "skull", "neck"),
        "In `tooth_brushing-v1` the bristles may be anywhere within 5 cm of the mouth, also on nose or cheek, v is "
        "what the head sees across the line from the bristles to the mouth, so that a head that shakes brushes itself "
        "on a brush at rest, and brushing adds half as much.",
    ),
}
