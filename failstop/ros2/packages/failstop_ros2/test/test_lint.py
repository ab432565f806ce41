"""ROS's own linters on this package: `colcon test --packages-select failstop_ros2`."""

from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1]


@pytest.mark.linter
@pytest.mark.flake8
def test_flake8() -> None:
    main = pytest.importorskip("ament_flake8.main")
    code, errors = main.main_with_errors(argv=["--config", str(PACKAGE / "test/flake8.ini"), str(PACKAGE)])
    assert code == 0, "\n".join(errors)


@pytest.mark.linter
@pytest.mark.xmllint
def test_xmllint() -> None:
    main = pytest.importorskip("ament_xmllint.main")
    assert main.main(argv=[str(PACKAGE)]) == 0
