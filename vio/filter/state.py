"""Where each block lies in the filter's flat vectors: named once, with units, for every kernel.

The nominal state x has the quaternions wxyz of R_WI, R_IC and R_WG; G is a level frame: gravity
falls along -z of G. The error state is local (right): R = R_hat Exp(dtheta); gravity's two errors
are the x and y of a right rotation of R_WG. The active dimension n is a prefix of the error:
21 (base), 27 (with the slowly varying pose bias), 30 (with the lever arm too).
"""

# nominal state x
X_P = 0  # p_WI [m]
X_V = 3  # v_WI [m/s]
X_Q = 6  # q_WI
X_BG = 10  # gyro bias in I [rad/s]
X_BA = 13  # accelerometer bias in I [m/s^2]
X_QIC = 16  # q_IC: camera in IMU
X_TD = 20  # time offset [s]: t_imu = t_cam + td
X_QWG = 21  # q_WG: level frame in the map
X_PIC = 25  # p_IC [m]
X_BIAS = 28  # pose bias, in units of each frame's own sigma (its covariance's Cholesky factor)
# what the filter remembers of its innovations (vio.memory), newest first
LAGS = 5
X_RECENT = 34
X_SUMS = X_RECENT + 6 * LAGS  # their products at lags 0 to LAGS
X_LAST = X_SUMS + LAGS + 1  # [s], when the newest was
NOMINAL = X_LAST + 1
MEMORY = NOMINAL - X_RECENT

# error state
P = 0  # [m]
V = 3  # [m/s]
TH = 6  # [rad], right rotation in I
BG = 9  # [rad/s]
BA = 12  # [m/s^2]
EX = 15  # [rad], right rotation in C
TD = 18  # [s]
GR = 19  # [rad], two of them
BIAS = 21  # [sigmas] (6)
LEVER = 27  # [m], in I
BASE, WITH_BIAS, WITH_LEVER = 21, 27, 30

# process noise q: squared densities, and two figures that propagation needs
N_GYRO = 0  # [rad^2/s]
N_ACCEL = 1  # [m^2/s^3]
N_GYRO_WALK = 2  # [rad^2/s^3]
N_ACCEL_WALK = 3  # [m^2/s^5]
N_EX_WALK = 4  # [rad^2/s]
N_TD_WALK = 5  # [s^2/s]
N_BIAS_RATE = 6  # 1 / correlation time of the pose bias [1/s]
N_GRAVITY = 7  # magnitude [m/s^2]
NOISE = 8

# one measurement as a row of numbers: kind, count, then its payload
M_POSE, M_CORNERS, M_STILL, M_RIG, M_CLOCK, M_OPEN = 0, 1, 2, 3, 4, 5
POSE_NUMBERS = 3 + 4 + 36 + 3  # pivot in C, q_WC, cov of both, pivot in W: see measurements.pivot
TAG_NUMBERS = 78  # see vio.corners
STILL_NUMBERS = 1  # variance of each velocity axis


# what became of a measurement
PENDING, ACCEPTED, POSITION_ONLY, ROTATION_ONLY, REJECTED, SINGULAR = 0, 1, 2, 3, 4, 5
