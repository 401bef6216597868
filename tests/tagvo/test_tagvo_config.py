"""Bad configuration in, one line out: where, what came, what is allowed."""

import pytest
from pydantic import ValidationError

from tagvo.config import TagvoConfig, load_tagvo_config, validated
from tagvo.errors import ConfigError


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"select": "JBTT"}, "c.yaml tagvo.select: unknown 'JBTT'; choose one of JBT, TBS, ALL"),
        ({"pose": "both"}, "c.yaml tagvo.pose: unknown 'both'; choose one of fused, joint"),
        ({"mean": None}, "c.yaml tagvo.mean: unknown None; choose one of QL2, CL2"),
        (
            {"noise": {"sigma": 1}},
            "c.yaml tagvo.noise: unknown 'sigma'; choose one of corner_px, image_px, blur",
        ),
        (
            {"iqr": {"quartiles": "tukey"}},
            "c.yaml tagvo.iqr.quartiles: unknown 'tukey'; choose one of hazen, linear, weibull",
        ),
        ({"iqr": {"gain": 0}}, "c.yaml tagvo.iqr.gain: 0; input should be greater than 0"),
        (
            {"iqr": {"gain": "much"}},
            "c.yaml tagvo.iqr.gain: 'much'; input should be a valid number",
        ),
        ({"iqr": {"gain": float("nan")}}, "c.yaml tagvo.iqr.gain: nan; input should be a finite"),
        ({"iqr": {"gain": float("inf")}}, "c.yaml tagvo.iqr.gain: inf; input should be a finite"),
        ({"noise": {"corner_px": float("inf")}}, "c.yaml tagvo.noise.corner_px: inf; input should"),
        ({"floor": {"focal_rel": float("inf")}}, "c.yaml tagvo.floor.focal_rel: inf; input should"),
        ({"refine": 11}, "c.yaml tagvo.refine: 11; input should be less than or equal to 10"),
        ({"refine": 1.5}, "c.yaml tagvo.refine: 1.5; input should be a valid integer"),
        ({"iqr": 3}, "c.yaml tagvo.iqr: 3; a mapping `key: value` is needed"),
        ([1], "c.yaml tagvo: [1]; a mapping `key: value` is needed"),
        (
            {"joint": {"reject_weight": 2}},
            "c.yaml tagvo.joint.reject_weight: 2; input should be le",
        ),
    ],
)
def test_the_message_says_where_what_and_what_is_allowed(data, message):
    with pytest.raises(ConfigError) as err:
        validated(TagvoConfig, data, "c.yaml", "tagvo")
    assert str(err.value).startswith(message)
    assert "\n" not in str(err.value)


def test_an_unknown_key_at_the_top_lists_the_keys():
    with pytest.raises(
        ConfigError, match=r"^c\.yaml tagvo: unknown 'sellect'; choose one of pose,"
    ):
        validated(TagvoConfig, {"sellect": "JBT"}, "c.yaml", "tagvo")
    with pytest.raises(ConfigError, match=r"^c\.yaml: unknown 'sellect'; choose one of pose,"):
        validated(TagvoConfig, {"sellect": "JBT"}, "c.yaml")


def test_defaults_are_the_papers_new_with_the_joint_pose():
    config = validated(TagvoConfig, {}, "c.yaml", "tagvo")
    stages = (config.select, config.outliers, config.weights, config.mean, config.pose)
    assert stages == ("TBS", "iqr", "W2", "QL2", "joint")
    assert config.iqr.quartiles == "hazen"


def test_a_configuration_cannot_be_changed():
    with pytest.raises(ValidationError):
        TagvoConfig().pose = "fused"


@pytest.mark.parametrize("text", ["tagvo: {select: JBT}\n", "other: 1\ntagvo: {select: JBT}\n"])
def test_the_section_of_a_file(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    assert load_tagvo_config(path).select == "JBT"


def test_an_empty_section_means_the_defaults(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("tagvo:\n")
    assert load_tagvo_config(path) == TagvoConfig()


@pytest.mark.parametrize("text", ["", "- 1\n", "tagvo: {select: [}\n", "tagvo: {1: 2}\n"])
def test_a_file_that_is_no_configuration_is_named(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"c\.yaml"):
        load_tagvo_config(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load_tagvo_config(tmp_path / "none.yaml")
