"""Marker files become joint angles: what was lost, exchanged or wrong is repairs or said."""

import numpy as np
import pytest

from residyn.errors import InputError
from residyn.recordings.motion_capture import angles as motion_capture
from tests.marker_files import placed, swinging, table, vicon

NAMES = ["Base", "Knee", "Tip"]


def read(folder, position, names=NAMES, file="trial.csv", **options):
    known = {k: options.pop(k) for k in ("normal", "link_lengths") if k in options}
    path = folder / file
    path.write_text(vicon(position, names, **options), newline="")
    return motion_capture.read(path, names, **known)


def arm(seed, noise=5e-5, **options):
    """A marker file's positions, (frames, 3, 3) m, and the angles that are in them."""
    rng = np.random.default_rng(seed)
    _, angle, _ = swinging(rng, **options)
    lengths = rng.uniform(0.2, 0.7, 2) if seed % 2 else np.full(2, rng.uniform(0.2, 0.7))
    heights = rng.uniform(-0.01, 0.01, 3) if seed % 3 else None
    position = placed(angle, lengths, table(rng, rng.uniform(0, 0.5)), heights=heights)
    return position + noise * rng.standard_normal(position.shape), angle, rng


def swapped(position, pair, first, last):
    """Labels of two markers exchanged in frames `first` to `last`, counted from one."""
    position = position.copy()
    i, j = pair
    part = slice(first - 1, last)
    position[part, [i, j]] = position[part, [j, i]]
    return position


def lose(rng, position, share=0.05, longest=1):
    position = position.copy()
    frames, markers = position.shape[:2]
    gone = np.zeros((frames, markers), dtype=bool)
    while gone.mean() < share:
        at = rng.integers(frames)
        gone[at : at + rng.integers(1, longest + 1), rng.integers(markers)] = True
    position[gone] = np.nan
    return position


def worst(ours, theirs):
    return np.nanmax(np.abs(ours.angle - theirs.angle))


# What is right


def test_angles_are_those_that_were_put_in(tmp_path):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        _, angle, _ = swinging(rng)
        lengths = rng.uniform(0.2, 0.8, 2)
        seen = read(tmp_path, placed(angle, lengths))
        turns = np.round((seen.angle - angle) / (2 * np.pi))
        assert (turns == turns[0]).all()
        np.testing.assert_allclose(seen.angle - 2 * np.pi * turns, angle, atol=2e-6)
        np.testing.assert_allclose(seen.link_lengths, lengths, atol=1e-6)
        assert seen.repairs == ()
        assert seen.warnings == ()


def test_a_table_that_leans_changes_angles_by_a_constant(tmp_path):
    rng = np.random.default_rng(0)
    _, angle, _ = swinging(rng)
    axes = table(rng, 0.4)
    seen = read(tmp_path, placed(angle, [0.4, 0.3], axes, heights=[0.01, 0.0, -0.02]))
    np.testing.assert_allclose(seen.normal, axes[:, 2], atol=1e-4)
    np.testing.assert_allclose(np.ptp(seen.angle - angle, axis=0), 0, atol=1e-5)


def test_the_normal_may_be_given_and_says_which_way_angles_grow(tmp_path):
    rng = np.random.default_rng(1)
    _, angle, _ = swinging(rng)
    here = placed(angle, [0.4, 0.3])
    over = read(tmp_path, here, normal=[0, 0, 2])
    under = read(tmp_path, here, normal=[0, 0, -1])
    np.testing.assert_allclose(under.angle[:, 1], -over.angle[:, 1], atol=1e-9)


@pytest.mark.parametrize("links", [1, 3])
def test_chains_of_other_lengths(tmp_path, links):
    rng = np.random.default_rng(links)
    _, angle, _ = swinging(rng, joints=links, size=0.3)
    position = placed(angle, rng.uniform(0.2, 0.5, links))
    names = [f"m{i}" for i in range(links + 1)]
    clean = read(tmp_path, position, names)
    assert clean.angle.shape == (800, links)
    seen = read(tmp_path, lose(rng, swapped(position, (0, links), 300, 420)), names)
    assert worst(seen, clean) < 1e-3
    assert "frames 300 to 420" in seen.repairs[0]


# What is repairs


@pytest.mark.parametrize("seed", range(24))
def test_five_per_cent_lost_and_a_swapped_pair(tmp_path, seed):
    position, _, rng = arm(seed)
    pair = rng.choice(3, 2, replace=False)
    first = int(rng.integers(2, 500))
    last = int(rng.integers(first + 5, 799))
    broken = lose(rng, swapped(position, pair, first, last), longest=1 if seed % 2 else 25)
    clean, seen = read(tmp_path, position), read(tmp_path, broken)
    assert clean.repairs == ()
    assert worst(seen, clean) < 1e-3
    exchanged = [line for line in seen.repairs if "exchanged" in line]
    assert len(exchanged) == 1
    assert all(f'"{NAMES[i]}"' in exchanged[0] for i in pair)
    assert "lost in" in " ".join(seen.repairs)
    # An angle is lost only where a marker that it needs is.
    there = np.isfinite(swapped(broken, pair, first, last)[:, :, 0])
    assert np.isfinite(seen.angle[there[:, 1], 0]).mean() > 0.995
    assert np.isfinite(seen.angle[there[:, 1] & there[:, 2], 1]).mean() > 0.995


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 2)])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_swap_that_lasts_most_of_the_recording(tmp_path, pair, seed):
    position, _, rng = arm(seed, bend=1.0)
    clean = read(tmp_path, position)
    seen = read(tmp_path, lose(rng, swapped(position, pair, 81, 720)))
    assert worst(seen, clean) < 1e-3
    assert "most of it" in seen.repairs[0]


def test_a_swap_all_along_asks_whether_markers_are_in_order(tmp_path):
    position, _, _ = arm(3, bend=1.0)
    clean = read(tmp_path, position)
    seen = read(tmp_path, swapped(position, (0, 2), 1, 800))
    assert worst(seen, clean) < 1e-6
    assert "wrong order" in seen.repairs[0]


def test_labels_that_go_round(tmp_path):
    position, _, _ = arm(5)
    broken = position.copy()
    broken[200:300] = position[200:300][:, [1, 2, 0]]
    clean, seen = read(tmp_path, position), read(tmp_path, broken)
    assert worst(seen, clean) < 1e-6
    assert seen.repairs[0].startswith('"Base", "Knee" and "Tip" had exchanged labels')
    assert "frames 201 to 300" in seen.repairs[0]


def test_an_arm_whose_markers_are_equally_far_apart(tmp_path):
    """Bent by 120 degrees, the exchange of elbow and wrist is an arm again: continuity decides."""
    rng = np.random.default_rng(2)
    _, angle, _ = swinging(rng, bend=2 * np.pi / 3)
    position = placed(angle, [0.4, 0.4]) + 5e-5 * rng.standard_normal((800, 3, 3))
    clean = read(tmp_path, position)
    seen = read(tmp_path, lose(rng, swapped(position, (1, 2), 250, 460)))
    assert worst(seen, clean) < 1e-3
    assert len([line for line in seen.repairs if "exchanged" in line]) == 1


def test_ghosts_and_jumps_are_rejected_and_named(tmp_path):
    position, _, rng = arm(7)
    broken = position.copy()
    broken[100:112, 2] = [1.0, 2.0, 3.0]
    broken[400:403, 1] += [0.05, -0.03, 0.04]
    clean, seen = read(tmp_path, position), read(tmp_path, lose(rng, broken, 0.02))
    assert worst(seen, clean) < 1e-3
    rejected = [line for line in seen.repairs if "rejected" in line]
    assert [line.split(":")[0] for line in rejected] == ['"Knee"', '"Tip"']
    assert np.isnan(seen.angle[100:112, 1]).all()
    assert np.isfinite(seen.angle[103:110, 0]).any()


def test_the_base_is_known_where_it_is_lost_and_a_tip_is_not(tmp_path):
    position, _, _ = arm(1)
    broken = position.copy()
    broken[50:90, 0] = np.nan
    broken[200:230, 2] = np.nan
    clean, seen = read(tmp_path, position), read(tmp_path, broken)
    assert np.isfinite(seen.angle[50:90]).all()
    assert worst(seen, clean) < 1e-4
    assert np.isnan(seen.angle[200:230, 1]).all()
    assert np.isfinite(seen.angle[200:230, 0]).all()
    assert "40 of 800 frames, at most 40 in a row; its place is known" in seen.repairs[0]
    assert "they stay lost" in seen.repairs[1]


def test_an_elbow_is_put_back_where_that_is_sure_only(tmp_path):
    def gap(noise, bend):
        position, _, _ = arm(2, noise=noise, bend=bend)
        broken = position.copy()
        broken[300:330, 1] = np.nan
        return read(tmp_path, position), read(tmp_path, broken)

    clean, seen = gap(5e-6, 1.5)
    assert np.isfinite(seen.angle[300:330]).all()
    assert worst(seen, clean) < 1e-3
    assert "30 put back" in seen.repairs[0]
    for noise, bend in ((1e-3, 1.5), (5e-6, 0.0)):  # too noisy; straight
        _, seen = gap(noise, bend)
        assert np.isnan(seen.angle[300:330]).any()


# What is doubted or refused


def test_links_are_held_against_their_known_lengths(tmp_path):
    _, angle, _ = swinging(np.random.default_rng(4))
    position = placed(angle, [0.4, 0.3])
    assert read(tmp_path, position, link_lengths=[0.4, 0.3]).warnings == ()
    (doubt,) = read(tmp_path, position, link_lengths=[0.4, 0.31]).warnings
    assert doubt.startswith('link 2, "Knee" to "Tip", is 0.3 m long by its markers')
    with pytest.raises(InputError, match=r'link 1, "Base" to "Knee", is 0\.4 m'):
        read(tmp_path, position, link_lengths=[0.8, 0.3])


def test_a_link_that_is_not_rigid_is_doubted(tmp_path):
    t, angle, _ = swinging(np.random.default_rng(4))
    position = placed(angle, [0.4, 0.3])
    position[:, 2, 0] += 0.012 * np.sin(7 * t)
    assert any("changes its length" in doubt for doubt in read(tmp_path, position).warnings)


def test_markers_of_no_arm_are_refused(tmp_path):
    noise = np.random.default_rng(0).normal(size=(300, 3, 3))
    with pytest.raises(InputError, match=r"trial\.csv: markers .* no chain of rigid links"):
        read(tmp_path, noise)


def test_a_motion_that_fixes_no_plane_asks_for_the_normal(tmp_path):
    rng = np.random.default_rng(0)
    _, angle, _ = swinging(rng, size=0.01, bend=0.0)
    position = placed(angle, [0.4, 0.3]) + 2e-4 * rng.standard_normal((800, 3, 3))
    assert any("give normal" in doubt for doubt in read(tmp_path, position).warnings)
    assert read(tmp_path, position, normal=[0, 0, 1]).warnings == ()


@pytest.mark.parametrize(
    ("markers", "words"),
    [
        (None, 'markers is missing: name them from base to tip, as ["Shoulder"'),
        ("Base", "must be a list of names"),
        (["Base", "Knee", "Tipp"], 'there is no marker "Tipp": did you mean "Tip"?'),
        (["Base", "Knee", "Base"], "names must differ"),
        (["Base", "Arm:Base", "Tip"], "are the same marker"),
        (["Base"], "markers has 1 names: must have at least 2"),
        ([1, 2], "must be names"),
    ],
)
def test_refuses_markers(tmp_path, markers, words):
    _, angle, _ = swinging(np.random.default_rng(0))
    path = tmp_path / "trial.csv"
    path.write_text(vicon(placed(angle, [0.4, 0.3]), NAMES))
    with pytest.raises(InputError) as caught:
        motion_capture.read(path, markers)
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)


# Recordings


def test_a_recording_is_counted_from_rest(tmp_path):
    rng = np.random.default_rng(3)
    _, angle, pose = swinging(rng, frames=2000, size=0.1)
    seen = read(tmp_path, placed(angle, [0.4, 0.3]))
    turns = 2 * np.pi * np.round((seen.angle[0] - angle[0]) / (2 * np.pi))
    here = seen.recording(role="check")
    assert here.theta2 == pytest.approx(pose[1] + turns[1], abs=1e-3)
    np.testing.assert_allclose(here.angle, angle - pose, atol=1e-3)
    assert here.role == "check"
    assert any("counted from rest" in line for line in here.warnings)
    given = seen.recording(theta2=pose[1] + turns[1])
    np.testing.assert_allclose(given.angle[:, 1], (angle - pose)[:, 1], atol=1e-5)
    wrong = seen.recording(theta2=pose[1] + turns[1] + 0.1)
    assert any("leave theta2 out" in line for line in wrong.warnings)


def test_what_was_repaired_is_a_recordings_warning(tmp_path):
    position, _, _ = arm(1)
    here = read(tmp_path, swapped(position, (1, 2), 100, 200)).recording(name="mine")
    assert any(line.startswith('mine: "Knee" and "Tip" had exchanged') for line in here.warnings)


def test_a_short_recording_says_that_rest_is_rough(tmp_path):
    t = np.arange(300) / 100
    angle = np.stack([0.5 + 0.1 * np.cos(4 * t), 1.0 + 0.1 * np.cos(4 * t)], axis=1)
    here = read(tmp_path, placed(angle, [0.4, 0.3])).recording()
    assert any("known roughly" in line for line in here.warnings)
    assert here.rest_estimated
