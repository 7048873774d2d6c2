// What the host's Python and the C share; cffi reads it, too.

#define AHEAD 100    // taps of the path to come, ms
#define TAPS 501     // of them all
#define COUPLINGS 8

struct hframe_coupling {
    int answer, command, along;    // axes; along is negative without a lever arm
    double centre, h[TAPS];
};

// h[0] belongs to the oldest sample of the path. least and most are the travel, and edge the
// distance from its edge within which the command fades into the path, mm.
struct hframe_kernel {
    double least[2], most[2], edge, axis[2][TAPS];
    int couplings;
    struct hframe_coupling coupling[COUPLINGS];
};

struct stepper_kinematics *hframe_live_alloc(struct stepper_kinematics *orig
                                             , const struct hframe_kernel *kernel);
void hframe_live_hand_over(struct stepper_kinematics *from, struct stepper_kinematics *to);
void hframe_live_reset(struct stepper_kinematics *sk);
double hframe_live_window(struct stepper_kinematics *sk);
