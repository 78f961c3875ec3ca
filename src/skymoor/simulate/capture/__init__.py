# SPDX-License-Identifier: Apache-2.0
"""Who photographs the site: a flight, people who walk, security cameras."""

from skymoor.simulate.capture.shots import Shot, airborne_shots, ground_shots, security_shots, true_view

__all__ = ["Shot", "airborne_shots", "ground_shots", "security_shots", "true_view"]
