// What the host's Python and the C share; cffi reads it, too.

#define AHEAD 100    // taps of the path to come, ms
#define TAPS 501     // of them all

// h[0] belongs to the oldest sample of the path. least and most are the travel, and edge the
// distance from its edge within which the command fades into the path, mm. racking, if it racks, is
// the angle for the path of x, and x_c where its lever arm is 0.
struct hframe_kernel {
    double least[2], most[2], edge, axis[2][TAPS];
    int racks;
    double x_c, racking[TAPS];
};

struct stepper_kinematics *hframe_live_alloc(struct stepper_kinematics *orig
                                             , const struct hframe_kernel *kernel);
void hframe_live_hand_over(struct stepper_kinematics *from, struct stepper_kinematics *to);
void hframe_live_reset(struct stepper_kinematics *sk);
double hframe_live_window(struct stepper_kinematics *sk);
