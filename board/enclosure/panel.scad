// A seat for a 7-inch display on top of the housing: four posts over the camera's plate carry an open frame, into which the
// display is laid. Part of retrograph.scad, which includes this file; lengths in mm.

/* [Panel: a frame on posts over the camera, into which a 7-inch display is laid] */
// Maker's figures of the first Raspberry Pi Touch Display: glass 192.96 x 110.76, of which 154.08 x 85.92 shine. Where its
// holes are is not needed: it lies in the frame by its glass. Its depth was found in no text of the maker's: measure yours.
panel = [192.96, 110.76];
panel_view = [154.08, 85.92];
panel_back = 20;            // from the glass's lower face to the last of what stands out behind
panel_edge = 3;             // glass and the foam tape below it, together
panel_gap = 0.6;            // around the glass
panel_ledge = [8, 2.5];     // what the glass lies on: at its short sides, at its long ones, where metal begins sooner
panel_posts = 24;           // from the camera's plate to the frame: the ribbon's room
panel_post = 8;             // of a post: diameter
panel_screw = 40;           // M3, through frame, post and plate into the body
panel_floor = 3;
panel_clip = [12, 3];       // of a clip: width, thickness
panel_clip_over = 4;        // how far it reaches over the glass
panel_clips_at = 70;        // from the middle of a long side
panel_boss = 6;             // what a clip is screwed to stands out so far

// --- what follows from these and from retrograph.scad ----------------------------------------------------------------------

post_at = (outer_r + 2) / sqrt(2);                                  // over the screws of the camera's plate, in x and y
screw_head = 3.5;                                                   // of an M3 screw, and air
panel_pocket = [panel.y, panel.x] + 2 * panel_gap * [1, 1];         // the panel lies across, its long side along y
panel_outer = panel_pocket + 2 * wall * [1, 1];
panel_rest = panel_floor + screw_head + panel_back;                 // from the frame's lower face to where the glass lies
panel_height = panel_rest + panel_edge;
// Beside the Pi's USB and network sockets, which face up beyond the tray's end: plugs go in past the frame.
panel_x = tray_face - 1.5 - panel_boss - panel_outer.x / 2;
panel_in_thread = panel_screw - panel_floor - panel_posts - plate_height;

echo(panel_width = panel_outer.x + 2 * panel_boss, panel_length = panel_outer.y, panel_height = panel_height, panel_x = panel_x);
assert(panel_in_thread >= 6, "the panel's screws hold by less than 6 mm of thread: take longer ones");
assert(panel_in_thread <= plate_thread, "the panel's screws end on the bottom of their threads: take shorter ones");
assert(panel_posts >= 15, "the camera's ribbon has no room to turn under the panel's frame");
assert(body_top + plate_height + panel_posts > tray_from + tray_length + 3, "the panel's frame lies on the tray's end");
assert(panel_x + panel_pocket.x / 2 > post_at + panel_post / 2, "a post stands below the panel frame's wall");
assert(panel_x + panel_pocket.x / 2 - panel_gap - panel_ledge.y > post_at + 2.75, "the ledge hides a post's screw");
assert(panel_clip_over < min(panel - panel_view) / 2 - 2, "the clips hide what the panel shows");
assert(min((panel - panel_view) / 2 - panel_ledge) > 2, "the ledge reaches below what the panel shows");
assert(panel_post / 2 - m3 / 2 >= 1.6, "a post's wall is too thin to print: make it wider");
assert(norm([post_at, post_at] - [19, 19]) > panel_post / 2 + 1, "a post stands on the camera's board");

// --- parts -------------------------------------------------------------------------------------------------------------

// Stands on four posts over the camera's plate, held by that plate's own four screws, longer ones. Open below: all cables pass
// there. The glass lies on the ledge, which slopes at 45 degrees below, so that it prints without support; clips hold it down.
// Its origin is the body's axis.
module panel_frame() {
    lower = [panel_x, 0] - panel_outer / 2;
    pocket = [panel_x, 0] - panel_pocket / 2;
    difference() {
        union() {
            difference() {
                translate(lower) cube([panel_outer.x, panel_outer.y, panel_height]);
                translate([pocket.x, pocket.y, -1]) cube([panel_pocket.x, panel_pocket.y, panel_height + 2]);
            }
            intersection() {
                translate(lower) cube([panel_outer.x, panel_outer.y, panel_height]);
                union() {
                    for (side = [-1, 1]) {
                        translate([panel_x + side * panel_pocket.x / 2, lower.y, panel_rest])
                            rotate([0, 45, 0]) square_bar((panel_ledge.y + panel_gap) * sqrt(2), panel_outer.y);
                        translate([lower.x + panel_outer.x, side * panel_pocket.y / 2, panel_rest]) rotate(90)
                            rotate([0, 45, 0]) square_bar((panel_ledge.x + panel_gap) * sqrt(2), panel_outer.x);
                    }
                }
            }
            for (y = [-1, 1]) translate([lower.x, y * post_at - 6, 0]) cube([panel_outer.x, 12, panel_floor]);
            for (x = [-1, 1], y = [-1, 1]) translate([panel_x + x * (panel_outer.x + panel_boss - 1) / 2, y * panel_clips_at, 0])
                translate([-(panel_boss + 1) / 2, -panel_clip.x / 2, 0]) cube([panel_boss + 1, panel_clip.x, panel_height]);
        }
        translate([pocket.x, pocket.y, panel_rest]) cube([panel_pocket.x, panel_pocket.y, panel_height]);
        for (x = [-1, 1], y = [-1, 1]) {
            translate([x * post_at, y * post_at, -1]) cylinder(r = m3 / 2, h = panel_floor + 2);
            translate([panel_x + x * (panel_outer.x / 2 + 2.5), y * panel_clips_at, panel_height - 12])
                cylinder(r = m3_tapped / 2, h = 13);
        }
    }
}
// Along y, its section's middle at the origin.
module square_bar(side, length) translate([-side / 2, 0, -side / 2]) cube([side, length, side]);

module panel_post() {
    difference() {
        cylinder(r = panel_post / 2, h = panel_posts);
        translate([0, 0, -1]) cylinder(r = m3 / 2, h = panel_posts + 2);
    }
}

// Lies on the frame's rim, its screw at the origin, the glass towards -x.
module panel_clip() {
    reach = 2.5 + wall + panel_gap + panel_clip_over;
    difference() {
        translate([-reach, -panel_clip.x / 2, 0]) cube([reach + panel_boss - 2.5, panel_clip.x, panel_clip.y]);
        translate([0, 0, -1]) cylinder(r = m3 / 2, h = panel_clip.y + 2);
    }
}

// The seat in its place.
module panel_seat() {
    color("gray") for (x = [-1, 1], y = [-1, 1]) translate([x * post_at, y * post_at, body_top + plate_height]) panel_post();
    translate([0, 0, body_top + plate_height + panel_posts]) {
        color("dimgray") panel_frame();
        color("gray") for (x = [0, 1], y = [-1, 1]) translate([panel_x, 0, 0]) rotate(180 * x)
            translate([panel_outer.x / 2 + 2.5, y * panel_clips_at, panel_height]) panel_clip();
    }
}
module panel_glass() {
    thickness = 1.6;
    translate([panel_x - panel.y / 2, -panel.x / 2, body_top + plate_height + panel_posts + panel_height - thickness])
        cube([panel.y, panel.x, thickness]);
}

// What the seat shares with other parts, with a Pi's sockets and the plugs above them: nothing, or it cannot be built.
module panel_overlap() {
    intersection() {
        translate([0, 0, 0.01]) panel_seat();
        union() {
            translate([0, 0, body_top]) camera_plate();
            camera();
            placed_tray();
            placed_saddle();
            translate([tray_face + boss_height, -28, tray_from]) cube([20, 56, tray_length + 50]);
        }
    }
}
