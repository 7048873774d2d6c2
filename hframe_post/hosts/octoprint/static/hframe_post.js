// A line in the list of files: what hframe-post did with a file, and its whole summary as a tooltip.
$(function () {
    const line =
        '<div class="hframe-post" data-bind="visible: $data.hframe_post, ' +
        "text: $data.hframe_post ? hframe_post.line : '', " +
        "attr: {title: $data.hframe_post ? hframe_post.all : ''}, " +
        "css: {'text-error': $data.hframe_post && hframe_post.line.startsWith('NOT')}\"></div>";
    $("#files_template_machinecode").text(function (index, template) {
        return template.replace('<div class="additionalInfo', line + "$&");
    });
});
