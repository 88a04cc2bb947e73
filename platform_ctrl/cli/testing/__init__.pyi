from .assertions import assert_baseline as assert_baseline
from .assertions import assert_requirements as assert_requirements
