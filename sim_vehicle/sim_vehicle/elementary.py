"""Elementary functions without branches and calls, which become SIMD code in a loop over wheels.

The functions of the mathematical library are calls, which keep the loop from becoming SIMD code
(tests/tools/test_swarm_of_cars.py).

These are exactly odd or even, and agree with the library within 2 units in the last place
(tests/plant/test_elementary.py). Sources of the polynomials: sine and cosine, S. L. Moshier, Cephes
Mathematical Library, sin.c; arc tangent and arc sine, Sun Microsystems, fdlibm, s_atan.c and
e_asin.c. They are evaluated in Estrin's order, which allows more operations in parallel than
Horner's.
"""

import math

from ampc_msgs_config.compiled import inlined

ROUND = 1.5 * 2.0**52
"""Adding and subtracting it rounds to the nearest integer."""
PI_1, PI_2, PI_3 = 1.57079625129699707031, 7.54978941586159635335e-8, 5.39030285815811905290e-15
"""pi / 2 in parts of 24, 24 and 53 bits, so that a multiple of the first two is exact."""
PI_LOW = 6.123233995736765886130e-17
"""Difference between pi / 2 and its double."""
TAN_3_PI_8, TAN_PI_8 = 1.0 + math.sqrt(2.0), math.sqrt(2.0) - 1.0


@inlined
def nearest(x: float) -> float:
    """Return the nearest integer, half to even, for |x| < 2^51."""
    return (x + ROUND) - ROUND


@inlined
def sine_and_cosine(x: float) -> tuple[float, float]:
    """Return sine and cosine of an angle |x| < 10^6 [rad]."""
    q = nearest(x * (2.0 / math.pi))  # quarter turns
    r = ((x - q * PI_1) - q * PI_2) - q * PI_3
    z = r * r
    w = z * z
    s0 = -1.66666666666666307295e-1 + z * 8.33333333332211858878e-3
    s1 = -1.98412698295895385996e-4 + z * 2.75573136213857245213e-6
    s2 = -2.50507477628578072866e-8 + z * 1.58962301576546568060e-10
    c0 = 4.16666666666665929218e-2 + z * -1.38888888888730564116e-3
    c1 = 2.48015872888517045348e-5 + z * -2.75573141792967388112e-7
    c2 = 2.08757008419747316778e-9 + z * -1.13585365213876817300e-11
    sin = r + r * z * (s0 + w * (s1 + w * s2))
    cos = (1.0 - 0.5 * z) + w * (c0 + w * (c1 + w * c2))
    turned = q != 2.0 * nearest(0.5 * q)
    quadrant = q - 4.0 * nearest(0.25 * q)  # -2 .. 2
    sine, cosine = (cos, sin) if turned else (sin, cos)
    sine = -sine if (quadrant < -0.5) | (quadrant > 1.5) else sine
    cosine = -cosine if (quadrant > 0.5) | (quadrant < -1.5) else cosine
    return sine, cosine


@inlined
def sine(x: float) -> float:
    """Return the sine of an angle |x| <= pi [rad], by ten terms of the series about 0."""
    a = abs(x)
    r = min(a, (math.pi - a) + 2.0 * PI_LOW)
    z = r * r
    w = z * z
    v = w * w
    p0 = -1.0 / 6.0 + z * (1.0 / 120.0)
    p1 = -1.0 / 5040.0 + z * (1.0 / 362880.0)
    p2 = -1.0 / 39916800.0 + z * (1.0 / 6227020800.0)
    p3 = -1.0 / 1307674368000.0 + z * (1.0 / 355687428096000.0)
    p4 = -1.0 / 121645100408832000.0 + z * (1.0 / 51090942171709440000.0)
    p = ((p0 + w * p1) + v * (p2 + w * p3)) + v * v * p4
    return math.copysign(r + r * z * p, x)


@inlined
def arc_tangent(x: float) -> float:
    """Return the angle in [-pi/2, pi/2] of a tangent, which may be infinite [rad]."""
    a = abs(x)
    near, far = a <= TAN_PI_8, a > TAN_3_PI_8
    turn = 0.0 if near else (0.5 * math.pi if far else 0.25 * math.pi)
    over = a if near else (-1.0 if far else a - 1.0)
    t = over / (1.0 if near else (a if far else a + 1.0))  # tan(atan(a) - turn)
    z = t * t
    w = z * z
    p0 = 3.33333333333329318027e-01 + z * -1.99999999998764832476e-01
    p1 = 1.42857142725034663711e-01 + z * -1.11111104054623557880e-01
    p2 = 9.09088713343650656196e-02 + z * -7.69187620504482999495e-02
    p3 = 6.66107313738753120669e-02 + z * -5.83357013379057348645e-02
    p4 = 4.97687799461593236017e-02 + z * -3.65315727442169155270e-02
    p5 = 1.62858201153657823623e-02
    v = w * w
    p = ((p0 + w * p1) + v * (p2 + w * p3)) + v * v * (p4 + w * p5)
    return math.copysign(turn + (t - t * z * p), x)


@inlined
def arc_sine(x: float) -> float:
    """Return the angle in [-pi/2, pi/2] of a sine, |x| <= 1 [rad]."""
    a = abs(x)
    near = a < 0.5
    z = a * a if near else 0.5 * (1.0 - a)  # squared sine of half the angle to pi / 2
    w = z * z
    p0 = 1.66666666666666657415e-01 + z * -3.25565818622400915405e-01
    p1 = 2.01212532134862925881e-01 + z * -4.00555345006794114027e-02
    p2 = 7.91534994289814532176e-04 + z * 3.47933107596021167570e-05
    q0 = 1.0 + z * -2.40339491173441421878e00
    q1 = 2.02094576023350569471e00 + z * -6.88283971605453293030e-01
    ratio = z * (p0 + w * (p1 + w * p2)) / (q0 + w * (q1 + w * 7.70381505559019352791e-02))
    s = a if near else math.sqrt(abs(z))  # abs: removes the check for negative numbers
    angle = s + s * ratio
    return math.copysign(angle if near else 0.5 * math.pi - 2.0 * angle, x)
