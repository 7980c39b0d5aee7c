import pytest
from conftest import MAKERS
from regrasp.verify.check import check


@pytest.mark.parametrize("name", MAKERS)
def test_accepts(handmade, name):
    plan, world = handmade[name]
    certificate = check(plan)
    for f in certificate.findings: print(f)
    assert certificate.passed, "\n".join(map(str, certificate.refusals))
