"""Sentence patterns that describe an activity: at least eight patterns an activity, twelve for picking and putting.

Clauses begin with the verb; the subject comes before them. Slots in braces are filled from what truly happened
(:mod:`prbench.synthetic.activities.wording`); a slot may be empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PATTERNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "walk straight": (
            "walks {speed} straight ahead", "goes {speed} forward a few steps", "takes {steps} steps forward {speed}",
            "moves {speed} forward in a straight line", "strolls {speed} ahead across the room",
            "keeps walking {speed} without turning", "heads {speed} straight on", "steps forward {speed} and stops",
            "crosses the floor {speed} in a line", "covers a short distance on foot {speed}",
        ),
        "walk turning": (
            "turns {side} and walks {speed}", "makes a turn to the {side} and goes {speed} on",
            "walks {speed} off to the {side}", "changes direction to the {side} and takes {steps} steps {speed}",
            "swings round to the {side} and heads off {speed}", "rotates towards the {side}, walks {speed} and stops",
            "goes {speed} towards the {side} side of the room", "faces {side} and starts walking {speed}",
            "veers {side} and strolls away {speed}",
        ),
        "curve": (
            "walks {speed} in a curve to the {side}", "follows a bend to the {side} on foot {speed}",
            "moves {speed} along an arc towards the {side}", "walks around something on the {side}",
            "goes round in a wide bow to the {side}", "curves gently {side} while walking {speed}",
            "circles {speed} to the {side}", "walks {speed} and gradually turns {side}",
            "wanders {speed} in a bow, bearing {side}",
        ),
        "turn": (
            "turns {amount} to the {side}", "rotates {amount} on the spot towards the {side}",
            "spins {amount} {sidewards}", "shifts the feet and turns {amount} {side}",
            "turns the whole body {amount} to the {side}", "pivots {amount} {sidewards} with small steps",
            "changes the facing direction {amount} to the {side}",
            "swivels {amount} to the {side} without walking away",
            "steps round {amount} until facing the {side}",
        ),
        "stand": (
            "stands still", "stays in place with both arms down", "waits without moving", "remains standing upright",
            "pauses for a moment", "stands quietly on both feet", "does nothing and stands", "rests on the spot",
            "holds still with arms hanging",
        ),
        "sit": (
            "sits still", "remains seated with both hands on the thighs", "rests on a chair", "stays seated quietly",
            "keeps sitting without moving", "sits upright and waits", "stays on the seat", "relaxes in the chair",
            "is seated with the hands in the lap",
        ),
        "look around": (
            "looks around, first {side}", "turns the head to the {side} and back again", "glances from side to side",
            "scans the room from {side} to {otherside}", "looks {side} and then {otherside}",
            "searches the surroundings with the eyes", "checks what is on both sides",
            "gazes about, starting on the {side}",
            "swings the head left and right", "inspects the room, beginning {side}",
        ),
        "look at hands": (
            "looks at both hands", "lifts the hands and inspects them", "holds the hands up in front of the chest",
            "examines the palms", "raises both forearms and looks down at the fingers",
            "studies something in the hands",
            "brings the hands together before the body and looks", "lowers the head to see both hands",
            "checks the hands in front of the chest",
        ),
        "sidestep": (
            "steps {sidewards}", "takes {distance} step to the {side}", "moves sideways to the {side}",
            "shuffles {sidewards} while facing forward", "shifts {distance} way to the {side}",
            "makes room by stepping {sidewards}", "side-steps to the {side}",
            "moves over {distance} bit to the {side}",
        ),
        "step back": (
            "steps back", "takes {distance} step backwards", "moves away backwards", "backs off",
            "retreats {distance} bit without turning round", "goes backwards carefully",
            "walks backwards a step or two",
            "makes {distance} backward move",
        ),
        "reach": (
            "reaches {height} with {hand}", "stretches {hand} out {height}", "extends {hand} {height} and pulls back",
            "puts {hand} forward {height} without taking anything", "reaches out {height} using {hand}",
            "touches something {height} with {hand}", "stretches {hand} {height} and lowers it again",
            "brings {hand} {height}, then back to the side", "leans in and reaches {height} with {hand}",
        ),
        "carry": (
            "walks while carrying something in {hand}", "carries something forward with {hand}",
            "holds something in {hand} and walks", "takes something across the room in {hand}",
            "moves forward with {hand} held before the chest", "brings something along in {hand}",
            "transports something with {hand} while walking", "goes ahead, {hand} holding something",
        ),
        "wipe": (
            "wipes a surface with {hand}", "rubs the table in wide circles with {hand}",
            "cleans something with {hand}",
            "moves {hand} in large circles before the body", "polishes a flat surface using {hand}",
            "sweeps {hand} round and round in front", "scrubs the worktop with {hand}",
            "wipes in circles, using {hand}",
        ),
        "stir": (
            "stirs something with {hand}", "mixes the food with {hand}", "makes quick small circles with {hand}",
            "whisks something in front using {hand}", "stirs a pot with {hand}",
            "swirls {hand} round before the belly",
            "keeps stirring with {hand}", "blends something by moving {hand} in a circle",
        ),
        "crouch": (
            "crouches and rises again", "bends the knees deeply and stands up", "squats down and comes back up",
            "goes down on bent legs, then stands", "lowers the body close to the ground and gets up",
            "ducks down for a moment", "squats and straightens up", "sinks down with bent knees and rises",
            "drops into a squat",
        ),
        "bend": (
            "bends forward and straightens up", "leans far forward from the hips", "bows down and comes up again",
            "stoops over and stands upright again", "tilts the upper body down", "folds forward at the waist",
            "bends down with nearly straight legs", "lowers the chest towards the floor and rises",
            "leans over to see something low",
        ),
        "wave": (
            "waves with {hand}", "raises {hand} and waves",
            "greets somebody with {hand}", "waves {hand} beside the head",
            "lifts {hand} and swings it from side to side", "says hello by waving {hand}", "shakes {hand} in the air",
            "gives a wave with {hand}", "beckons with {hand} raised",
        ),
        "raise arms": (
            "raises both arms", "lifts both hands above the head", "stretches the arms up and lowers them",
            "puts both arms in the air", "reaches for the ceiling with both hands",
            "throws the arms up and lets them fall",
            "extends both arms overhead", "holds both arms high for a moment", "brings the arms up and down",
        ),
        "scratch head": (
            "scratches the head with {hand}", "rubs the {side} side of the head", "touches the hair with {hand}",
            "puts {hand} to the head and scratches", "strokes the head with {hand}", "brings {hand} up to the ear",
            "scratches behind the ear using {hand}", "fixes the hair with {hand}",
        ),
        "sit down": (
            "sits down", "takes a seat", "lowers onto a chair", "sits down with hands on the thighs",
            "settles on a seat", "gets down onto the chair", "bends the knees and sits", "moves back and sits down",
        ),
        "stand up": (
            "stands up", "gets up from the chair", "rises from the seat", "leaves the chair and stands",
            "gets to the feet", "straightens the legs and stands",
            "comes up from sitting", "leans forward and stands up",
        ),
        "pick": (
            "picks up {thing} from {place} with {hand}", "takes {thing} off {place}", "grabs {thing} with {hand}",
            "lifts {thing} from {place} {manner}", "fetches {thing} using {hand}",
            "takes {thing} on the {side} {manner}",
            "reaches for {thing} and picks it up", "gets {thing} from {place} {manner}",
            "grasps {thing} with {hand} and lifts it",
            "collects {thing} from {place} with {hand}", "removes {thing} from {place}", "picks {thing} up {manner}",
            "closes {hand} around {thing} and raises it",
        ),
        "put": (
            "puts {thing} down on {place} with {hand}", "places {thing} on {place}", "sets {thing} down with {hand}",
            "returns {thing} to {place} {manner}", "drops {thing} off on {place}", "lays {thing} on {place} {manner}",
            "leaves {thing} on the {side} {manner}", "lowers {thing} onto {place} using {hand}",
            "puts {thing} back {manner}",
            "releases {thing} on {place} with {hand}", "positions {thing} on {place}",
            "stands {thing} on {place} {manner}",
            "lets go of {thing} with {hand}",
        ),
    }
)  # fmt: skip

BODY_POSTURE: Mapping[str, str] = MappingProxyType(
    {
        "sit": "is seated with the back upright",
        "sit down": "bends and lowers the body onto a seat",
        "stand up": "leans forward and rises from a seat",
        "crouch": "squats with bent knees and a leaning back, then stands upright",
        "bend": "bends the back far forward, then stands upright",
        "reach": "stands and leans slightly towards the target",
    }
)
"""Whole-body posture of the activities that change it; people stand upright in all others."""
