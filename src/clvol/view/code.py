"""A state as text that reproduces it: Python, options of `clvol render` as TOML and command, the fragment of an address."""

from __future__ import annotations

import ast
import base64
import binascii
import json
import math
import os
import shlex
import textwrap
import tomllib
from dataclasses import fields, replace
from typing import Any

import numpy as np

from clvol.base.errors import OptionError
from clvol.base.printable import printable
from clvol.filter.table import PICTURE_FILTER
from clvol.scene.camera import Camera
from clvol.scene.clip import Corner, Plane
from clvol.scene.joint import TransferFunction2D
from clvol.scene.light import Light, Material
from clvol.scene.mode import as_mode
from clvol.scene.transfer import FACTORS, TransferFunction
from clvol.view import media
from clvol.view.panes import PaneSize, SlicePane, camera_of, vertical
from clvol.view.resident import Resident
from clvol.view.state import WORDS, MediumState, State

__all__ = ["from_toml", "from_url", "python", "to_url", "toml"]

_PREFIX = "#s="
_READS_ALL = ast.dump(ast.parse("clvol.read_all", mode="eval").body)
_LONGEST = 1 << 18  # characters
_WIDE = 110  # characters per line
_UNHEARD = (
    *WORDS,
    "gradient-opacity",
    "shadow",
    "shadow-rays",
    "occlusion",
    "linear-light",
    "gradient",
    "pixel-filter",
    "color-bar",
)  # flags that some mode or filter does not have


# -- Python --------------------------------------------------------------------------------------------------


def python(resident: Resident, state: State, name: str, shown: PaneSize, size: tuple[int, int]) -> str:
    """A program whose `picture`, of this size in pixels, is what a pane shows.

    The source of what is viewed gives the program its volume; without one it expects `volume`.
    """
    lines = ["import clvol"]
    lines += ["import numpy as np"] if state.wiper is not None else []
    lines += ["from dataclasses import replace"] if state.media else []
    lines += ["from clvol.device import as_device"] if resident.limits else []
    lines += ["from clvol.show.picture import heat, to_bytes"] if state.heat and name == "3d" else []
    names = [*(["Mark", "measured"] if state.marks else []), *(["section"] if name != "3d" else [])]
    lines += [f"from clvol.view import {', '.join(names)}"] if names else []
    lines += [""]
    held = "volume"
    if resident.finer is not None and resident.finer_picture(state, shown, name, size) is not None:
        source, held = resident.finer.source, "level"
        lines += ["# volume: the clvol.LazyVolume that was viewed" if source is None else f"volume = {source}"]
    else:
        lines += _volume(resident, state)
    if resident.catalog.media:
        told, count = resident.layers.sources, len(resident.catalog.media) - 1
        known = f"# others: the {count} other media of the scene that was viewed, a list of clvol.Medium"
        lines += [known if told is None else f"others = [{', '.join(told)}]"]
    if resident.beyond and name == "3d":
        lines += [f"# first: the clvol.Medium that was viewed, for its {' and '.join(resident.beyond)}"]
    draw = _drawn if name == "3d" else _cut
    if state.wiper is None:
        lines += _limited(resident, draw(resident, state, name, shown, size, "picture"))
    else:
        edge = round(state.wiper.at * size[0])
        for side, chosen in (("left", state.filter), ("right", state.wiper.filter)):
            lines += _limited(resident, draw(resident, replace(state, filter=chosen), name, shown, size, side))
        lines += [f"picture = np.concatenate([left[:, :{edge}], right[:, {edge}:]], axis=1)"]
    lines += _limited(resident, _measured(resident, state, held)) if state.marks else []
    return "\n".join(lines) + "\n"


def _measured(resident: Resident, state: State, held: str) -> list[str]:
    """Lines that measure what the marks do, in the volume in memory."""
    words = _reconstruction(state) | _device(resident) | ({"smooth": True} if as_mode(state.mode).regions else {})
    given = "".join(f", {name}={_text(value)}" for name, value in words.items())
    lines = _volume(resident, state, held) if held != "volume" else []
    lines += ["marks = [", *(f"    Mark({mark.kind!r}, {_text(mark.points)})," for mark in state.marks), "]"]
    return [*lines, f"measures = [measured(mark, {held}{given}) for mark in marks]"]


def _volume(resident: Resident, state: State, name: str = "volume") -> list[str]:
    """Lines that read the volume of a state into a variable."""
    which = resident.catalog.which(state)
    if resident.catalog.volumes is None:
        lines = [f"# {name}: the clvol.Volume that was viewed"] if resident.source is None else [f"{name} = {resident.source}"]
    elif resident.source is None:
        words = ", ".join(f"{axis}={at!r}" for axis, at in resident.catalog.places(state).items())
        lines = ["# volumes: the clvol.Volumes that were viewed", f"{name} = volumes.pick({words})"]
    else:
        lines = [f"{name} = {_source(resident, state)}"]
    if which.labels is not None:
        what = "only" if which.labels.hidden is None else "without"
        chosen = which.labels.shown if which.labels.hidden is None else which.labels.hidden
        lines += [f"{name} = clvol.labels.{what}({name}, {list(chosen or ())!r})"]
    if state.label_rows:
        lines += [f"{name} = clvol.labels.with_table({name}, {state.label_rows!r})"]
    return lines


def _source(resident: Resident, state: State) -> str | None:
    """The Python text that gives a state's volume: of a file with several it reads only that one."""
    if resident.catalog.volumes is None or resident.source is None:
        return resident.source
    words = [f"{axis}={at!r}" for axis, at in resident.catalog.places(state).items()]
    try:
        tree = ast.parse(resident.source.strip(), mode="eval").body
    except (SyntaxError, ValueError):  # no program; whoever copies it sees what was meant
        return f"({resident.source}).pick({', '.join(words)})"
    if isinstance(tree, ast.Call) and ast.dump(tree.func) == _READS_ALL:
        tree.func = ast.parse("clvol.read", mode="eval").body
        tree.keywords += [ast.keyword(axis, ast.Constant(at)) for axis, at in resident.catalog.places(state).items()]
        return ast.unparse(tree)
    text = ast.unparse(tree)  # without comments, which would hide what follows
    text = text if isinstance(tree, (ast.Call, ast.Name, ast.Attribute, ast.Subscript)) else f"({text})"
    return f"{text}.pick({', '.join(words)})"


def _drawn(resident: Resident, state: State, name: str, shown: PaneSize, size: tuple[int, int], result: str) -> list[str]:
    finer = resident.finer_picture(state, shown, name, size)
    given = resident.arguments(_as_labelled(state), bare=state.heat) if finer is None else dict(finer.given)
    camera, mode = given.pop("camera"), given.pop("mode")
    given.pop("media", None)
    words = _reconstruction(state) | {"size": size} | given
    words |= {"outputs": "visited"} if state.heat else {}
    words |= _device(resident)
    scene = "volume"
    if resident.catalog.media or resident.beyond:
        own = [
            f"{key}={_text(words.pop(key))}"
            for key in ("filter", "boundary", "transfer", *WORDS, *FACTORS, "material")
            if key in words
        ]
        own += [f"{key}=first.{key}" for key in resident.beyond]
        hidden = resident.catalog.media and not media.of_state(resident.catalog.media, state)[0].visible
        own += ["visible=False"] if hidden else []
        mix = "" if resident.mix == "add" else f", mix={resident.mix!r}"
        scene = f"clvol.Scene([{', '.join([_call('clvol.Medium', ['volume', *own]), *_others(resident, state)])}]{mix})"
    texts = [scene, _camera(camera), repr(mode), *(f"{key}={_text(value)}" for key, value in words.items())]
    call = _call("clvol.render", texts)
    return [f"{result} = to_bytes(heat({call}))" if state.heat else f"{result} = {call}"]


def _others(resident: Resident, state: State) -> list[str]:
    """The other media of a list, with what the state changes of them."""
    if not state.media:
        return ["*others"] if resident.catalog.media else []
    shown = (*state.media[1:], *[MediumState()] * len(resident.catalog.media))
    each = zip(resident.catalog.media[1:], shown, strict=False)
    said = [{key: _text(value) for key, value in media.changes(medium, shown).items()} for medium, shown in each]
    own = [", ".join(f"{key}={text}" for key, text in words.items()) for words in said]
    return [f"replace(others[{k}], {words})" if words else f"others[{k}]" for k, words in enumerate(own)]


def _as_labelled(state: State) -> State:
    """A state for a volume that has the colours and opacities of labels already."""
    return replace(state, label_colors={}, label_opacities={})


def _cut(resident: Resident, state: State, name: str, shown: PaneSize, size: tuple[int, int], result: str) -> list[str]:
    pane = SlicePane.of(state, resident.volume, "xyz".index(name), shown)
    words: dict[str, Any] = {key: tuple(getattr(pane, key).tolist()) for key in ("middle", "right", "down")}
    words |= {"pixel": pane.pixel(size), "size": size} | pane.words
    words |= {"smooth": True} if as_mode(state.mode).regions else {}
    words |= media.slice_words(resident.catalog.media, state)
    if state.slice.thickness and not resident.volume.is_labels:
        words["filter"] = PICTURE_FILTER  # as of a plane, where the mode of a slab may have another
    words |= _reconstruction(state)
    finer = resident.finer_picture(state, shown, name, size)
    words |= {} if finer is None else finer.given
    words |= {"background": state.background} | _device(resident)
    texts = ["volume", *(f"{key}={_text(value)}" for key, value in words.items())]
    texts += [f"over=[{others}]"] if (others := ", ".join(_others(resident, state))) else []
    return [f"{result} = " + _call("section", texts)]


def _reconstruction(state: State) -> dict[str, Any]:
    """Filter and boundary rule, where they are not the defaults."""
    words = {"filter": state.filter} if state.filter is not None else {}
    return words if state.boundary == "mirror" else words | {"boundary": state.boundary}


def _device(resident: Resident) -> dict[str, Any]:
    return {"device": resident.device} if isinstance(resident.device, (str, int)) else {}


def _limited(resident: Resident, lines: list[str]) -> list[str]:
    """The lines under the limits of the device under which the view draws."""
    if not resident.limits:
        return lines
    words = ", ".join(f"{name}={value!r}" for name, value in resident.limits.items())
    device = ", ".join(map(repr, _device(resident).values()))
    return [f"with as_device({device}).limited({words}):", textwrap.indent("\n".join(lines), "    ")]


def _call(function: str, texts: list[str]) -> str:
    """A call on one line, or with a line for each argument."""
    line = f"{function}({', '.join(texts)})"
    return line if len(line) <= _WIDE else f"{function}(\n" + "".join(f"    {text},\n" for text in texts) + ")"


def _camera(camera: Camera) -> str:
    default = Camera()
    given = [
        f"{field.name}={_text(getattr(camera, field.name))}"
        for field in fields(Camera)
        if getattr(camera, field.name) != getattr(default, field.name)
    ]
    return f"clvol.Camera({', '.join(given)})"


def _text(value: Any) -> str:
    if isinstance(value, TransferFunction2D):
        given = {"boxes": value.boxes, "arches": value.arches} if value.image is None else {"image": value.image.json()}
        more = {name: part for name in ("unit_distance", *FACTORS) if (part := getattr(value, name)) is not None}
        return f"clvol.TransferFunction2D({', '.join(f'{name}={_text(part)}' for name, part in (given | more).items())})"
    if isinstance(value, TransferFunction):
        more = {name: getattr(value, name) for name in ("unit_distance", *FACTORS)}
        said = "".join(f", {name}={part!r}" for name, part in more.items() if part is not None)
        return f"clvol.TransferFunction({value.colors!r}, {value.opacities!r}{said})"
    if isinstance(value, Light):
        return f"clvol.Light({value.direction!r}, {value.color!r}, {value.frame!r})"
    if isinstance(value, Plane | Corner):
        return f"clvol.{type(value).__name__}({', '.join(f'{f.name}={_text(getattr(value, f.name))}' for f in fields(value))})"
    if isinstance(value, float) and math.isinf(value):
        return f"float('{value}')"
    if isinstance(value, Material):
        return f"clvol.Material({', '.join(f'{f.name}={getattr(value, f.name)!r}' for f in fields(value))})"
    if isinstance(value, (tuple, list)):
        inner = ", ".join(map(_text, value))
        return f"({inner}{',' if len(value) == 1 else ''})"
    if isinstance(value, np.generic):
        return repr(value.item())
    return repr(getattr(value, "name", value) if not isinstance(value, (str, bool, int, float)) and value is not None else value)


# -- the command ---------------------------------------------------------------------------------------------


def toml(resident: Resident, state: State, name: str, shown: PaneSize, size: tuple[int, int]) -> str:
    """The state as TOML: ``[view]`` has all of it (`from_toml`), ``[render]`` what flags of `clvol render` can express.

    A comment has the command, and what its flags cannot express.
    """
    flags, unsaid = _flags(resident, state, size)
    finer = resident.finer_picture(state, shown, name, size)
    if finer is not None and resident.finer is not None and name == "3d":
        flags |= {word: finer.given[word] for word in ("filter", "lod")}
        path, given = _input(resident.finer.source)
    else:
        path, given = _input(_source(resident, state))
    flags |= {flag.replace("_", "-"): value for flag, value in given.items()}
    command = ["clvol", "render", path, "-o", "picture.png"]
    for flag, value in flags.items():
        command += _flag(flag, value)
    lines = [f"# {' '.join(map(_shell_word, command))}"]
    lines += [f"# (no flag says: {', '.join(unsaid)})"] if unsaid else []
    lines += ["", "[render]", *(f"{flag} = {_toml_value(value)}" for flag, value in flags.items())]
    lines += ["", "[view]", f"state = {_toml_text(state.text())}"]
    return "\n".join(lines) + "\n"


def from_toml(text: str) -> State:
    """The state of a text of `toml`; `OptionError` if there is none."""
    try:
        found = tomllib.loads(text)
        coded = found["view"]["state"]
    except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise OptionError(f"a copied view must be TOML with a state in [view]; {error}") from None
    if not isinstance(coded, str):
        raise OptionError(f"the state in [view] must be a text; got {coded!r:.120}")
    return State.from_text(coded)


def _flags(resident: Resident, state: State, size: tuple[int, int]) -> tuple[dict[str, Any], list[str]]:
    """Options of `clvol render`, and what they cannot express."""
    camera, volume = state.camera, resident.volume
    view = camera_of(state).view(volume)
    x, y, z = (float(v) for v in view.forward)
    if volume.space == "image":
        y, z = -y, -z
    given = {
        "mode": state.mode,
        "size": list(size),
        "filter": state.filter,
        "boundary": _reconstruction(state).get("boundary"),
        "step": state.step,
        "azimuth": round(math.degrees(math.atan2(-x, y)), 9),
        "elevation": round(math.degrees(math.asin(max(-1.0, min(1.0, -z)))), 9),
        "zoom": camera.zoom,
        "fit": camera.fit,
        "projection": camera.projection,
        "preset": state.preset,
        "cmap": state.cmap,
        "opacity": state.opacity,
        "window": state.window and list(state.window),
        "gradient-opacity": state.gradient_opacity or None,
        "shadow": state.shadow or None,
        "shadow-rays": (state.shadow and state.shadow_rays) or None,
        "occlusion": state.occlusion or None,
        "linear-light": state.linear_light or None,
        "background": "none" if state.background is None else "#" + "".join(f"{round(255 * v):02x}" for v in state.background),
        "clip": state.clip and [*state.clip[0], *state.clip[1]],
        "clip-plane": [[*cut.normal, *cut.point] for cut in state.cuts if isinstance(cut, Plane)] or None,
        "clip-corner": [[*cut.low, *cut.high] for cut in state.cuts if isinstance(cut, Corner)] or None,
        **{name.replace("_", "-"): value for name, value in state.furniture.given.items()},
    }
    flags: dict[str, Any] = {flag: value for flag, value in given.items() if value is not None}
    flags |= {flag.replace("_", "-"): _text(value).strip("'") if not isinstance(value, (bool, int, float)) else value
             for flag, value in resident.beside.items() if flag != "skipping"}  # fmt: skip
    flags |= {flag: value for flag, value in resident.limits.items() if flag in ("evaluator", "fetch")}
    flags |= dict(state.options)
    heard = resident.arguments(_as_labelled(state))
    flags = {flag: value for flag, value in flags.items() if flag.replace("-", "_") in heard or flag not in _UNHEARD}
    inexpressible = {
        "where the camera was moved to": camera.target is not None or camera.distance is not None or camera.radius is not None,
        "that it was rolled": abs(float(view.right @ vertical(volume))) > 1e-6,
        "its field of view": camera.fov != Camera().fov,
        "the transfer function (--transfer FILE)": "transfer" in heard,
        "which labels are seen": resident.catalog.which(state).labels is not None,
        "colours and opacities of labels": bool(state.label_rows),
        "lights": "lights" in heard,
        "the material": heard.get("material") not in (None, Material()),
        "the other filter of the wiper": state.wiper is not None,
        "the other media": bool(resident.catalog.media),
        "what is measured": bool(state.marks),
        "the heat map (--heat-map FILE)": state.heat,
    }
    unsaid = [words for words, is_so in inexpressible.items() if is_so]
    return flags, unsaid


def _input(source: str | None) -> tuple[str, dict[str, Any]]:
    """The file in a Python text such as ``clvol.read("scan.nii.gz", channel=1).filled(0)``, and the options that read it."""
    try:
        tree = ast.parse(source or "", mode="eval").body
        filled: dict[str, Any] = {}
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Attribute) and tree.func.attr == "filled":
            filled = {"fill_nan": ast.literal_eval(tree.args[0]) if tree.args else "smoothly"}
            tree = tree.func.value
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Attribute) and tree.func.attr == "whole":
            tree = tree.func.value
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Attribute) and tree.func.attr in ("read", "open", "by_name"):
            name = str(ast.literal_eval(tree.args[0]))
            given = {keyword.arg: ast.literal_eval(keyword.value) for keyword in tree.keywords if keyword.arg} | filled
            given |= {"fill_nan": given.pop("missing")} if "missing" in given else {}
            return f"phantom:{name}" if tree.func.attr == "by_name" else name, given
    except (SyntaxError, TypeError, ValueError, IndexError):  # not one of our calls
        pass
    return "INPUT", {}


def _flag(flag: str, value: Any) -> list[str]:
    if isinstance(value, list) and isinstance(value[0], list):
        return [word for one in value for word in _flag(flag, one)]
    word = f"--{flag.replace('_', '-')}"
    if isinstance(value, bool):
        return [word if value else f"--no-{flag.replace('_', '-')}"]
    if flag == "color" and isinstance(value, (list, tuple)):
        return [word, " ".join(map(repr, value))]
    return [word, *(repr(v) if not isinstance(v, str) else v for v in (value if isinstance(value, (list, tuple)) else [value]))]


def _toml_value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, float):
        return repr(value)
    return _toml_text(value) if isinstance(value, str) else json.dumps(value)


def _toml_text(text: str) -> str:
    """A text for TOML, whose escapes are those of JSON, but for pairs of surrogates; it has none for bytes that are no UTF-8."""
    if any("\ud800" <= one <= "\udfff" for one in text):
        raise OptionError(f"TOML holds only texts of Unicode; got {text!r:.200}: copy as Python, which can name what is no UTF-8")
    coded = json.dumps(text, ensure_ascii=False)
    return "".join(
        one if one.isprintable() else f"\\u{ord(one):04x}" if one < "\U00010000" else f"\\U{ord(one):08x}" for one in coded
    )


def _shell_word(text: str) -> str:
    """A word of a command on one line: where quotes are not enough for a shell, in those of Bash, which know escapes."""
    if printable(text) == text:
        return shlex.quote(text)
    try:
        raw = os.fsencode(text)
    except UnicodeEncodeError as error:
        raise OptionError(f"a command can name only what a file can be called here; got {text!r:.200}") from error
    return "$'" + "".join(chr(b) if 0x20 <= b < 0x7F and b not in b"\\'" else f"\\x{b:02x}" for b in raw) + "'"


# -- an address ----------------------------------------------------------------------------------------------


def to_url(state: State) -> str:
    """The fragment of an address, ``#s=...``: compact JSON of what differs from the defaults, as base64url."""
    default, own = State().json(), state.json()
    brief = {name: value for name, value in own.items() if name == "version" or value != default[name]}
    text = json.dumps(brief, separators=(",", ":"), allow_nan=False).encode()
    return _PREFIX + base64.urlsafe_b64encode(text).decode().rstrip("=")


def from_url(text: str) -> State:
    """The state of an address, or of its fragment; `OptionError` if it has none, or one that is not allowed."""
    if not isinstance(text, str) or len(text) > _LONGEST or "s=" not in text:
        raise OptionError(f"an address must end in #s= and a state; got {text!r:.120}")
    coded = text.rpartition("s=")[2]
    try:
        raw = base64.b64decode(coded + "=" * (-len(coded) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError) as error:
        raise OptionError(f"the state of an address must be base64url; {error}") from None
    return State.from_text(raw)
